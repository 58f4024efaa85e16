/* transfer_oracle.h - transfer functions and segments in double, slow and plain, for the tests of tetcast.h */
#ifndef TRANSFER_ORACLE_H_INCLUDED
#define TRANSFER_ORACLE_H_INCLUDED

#ifndef TETCAST_H_INCLUDED
#error "include tetcast.h first"
#endif

#define ORACLE_SMOOTH 4
static const tetcast_control_point oracle_smooth[ORACLE_SMOOTH] = {
    {0.0f, {0.1f, 0.9f, 0.0f}, 0.0f},
    {0.3f, {0.4f, 0.5f, 1.0f}, 1.0f},
    {0.7f, {1.0f, 0.2f, 0.3f}, 4.0f},
    {1.0f, {0.2f, 0.0f, 0.6f}, 0.5f}};
#define ORACLE_STEPS 7
static const tetcast_control_point oracle_steps[ORACLE_STEPS] = {
    {0.0f, {0.2f, 0.8f, 0.1f}, 0.0f},
    {0.5f, {0.2f, 0.4f, 0.1f}, 0.0f},
    {0.5f, {1.0f, 0.4f, 0.9f}, 8.0f},
    {0.75f, {0.6f, 0.1f, 0.2f}, 8.0f},
    {0.75f, {0.3f, 0.3f, 0.3f}, 50.0f}, /* ignored: between two others of the same value */
    {0.75f, {0.1f, 0.9f, 0.0f}, 1.0f},
    {1.0f, {0.1f, 0.0f, 1.0f}, 1.0f}};
#define ORACLE_SCENE 5
static const tetcast_control_point oracle_scene[ORACLE_SCENE] = {
    {0.0f, {0.0f, 0.0f, 1.0f}, 0.0f},
    {0.4f, {0.0f, 0.8f, 0.2f}, 0.0f},
    {0.5f, {0.0f, 1.0f, 0.0f}, 4.0f},
    {0.6f, {0.2f, 0.8f, 0.0f}, 0.2f},
    {1.0f, {1.0f, 0.0f, 0.0f}, 1.5f}};

TEST_FN tetcast_transfer *oracle_transfer(const tetcast_control_point *p, size_t count, int independent, const tetcast_isovalue *iso, size_t iso_count) {
    tetcast_transfer_desc d;
    tetcast_transfer *t = NULL;
    memset(&d, 0, sizeof d);
    d.points = p;
    d.point_count = count;
    d.isovalues = iso;
    d.isovalue_count = iso_count;
    d.color_mode = independent ? TETCAST_COLOR_INDEPENDENT : TETCAST_COLOR_ASSOCIATED;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    return t;
}

TEST_FN tetcast_optics *oracle_optics(const tetcast_control_point *p, size_t count, int independent, const tetcast_isovalue *iso, size_t iso_count,
                                      const tetcast_optics_desc *d) {
    tetcast_transfer *t = oracle_transfer(p, count, independent, iso, iso_count);
    tetcast_optics *o = NULL;
    CHECK(tetcast_optics_create(t, d, &o) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    return o;
}

TEST_FN void oracle_peak(tetcast_control_point p[5], float at, float half_width, float extinction) {
    int i;
    memset(p, 0, 5 * sizeof *p);
    p[1].value = at - half_width;
    p[2].value = at;
    p[3].value = at + half_width;
    p[4].value = 1.0f;
    p[2].extinction = extinction;
    for (i = 0; i < 5; i++) {
        p[i].rgb[0] = i < 2 ? 0.0f : 1.0f;
        p[i].rgb[1] = i == 2 ? 0.5f : 1.0f;
        p[i].rgb[2] = 0.25f * (float)i;
    }
}

/* Limits at s: side 0 from below, 1 from above. out: r, g, b, extinction. */
TEST_FN void oracle_eval(const tetcast_control_point *p, size_t n, double s, int side, double out[4]) {
    size_t a = 0, b, i;
    int c;
    double x;
    /* a: last point that counts as left of s; b: first that counts as right */
    b = n;
    for (i = n; i-- > 0;) {
        const double v = (double)p[i].value;
        if (side == 0 ? v >= s : v > s) b = i;
    }
    a = b;
    if (b == 0) {
        for (c = 0; c < 4; c++) out[c] = (double)(c == 3 ? p[0].extinction : p[0].rgb[c]);
        return;
    }
    a = b - 1;
    if (b == n) {
        for (c = 0; c < 4; c++) out[c] = (double)(c == 3 ? p[a].extinction : p[a].rgb[c]);
        return;
    }
    x = (s - (double)p[a].value) / ((double)p[b].value - (double)p[a].value);
    for (c = 0; c < 4; c++) {
        const double u = (double)(c == 3 ? p[a].extinction : p[a].rgb[c]);
        const double v = (double)(c == 3 ? p[b].extinction : p[b].rgb[c]);
        out[c] = u + (v - u) * x;
    }
}

/* 8-point Gauss-Legendre on [0, 1] */
static const double oracle_x[8] = {0.019855071751231884, 0.101666761293186630, 0.237233795041835507,
                                   0.408282678752175098,
                                   0.591717321247824902, 0.762766204958164493, 0.898333238706813370,
                                       0.980144928248768116};
static const double oracle_w[8] = {0.050614268145188130, 0.111190517226687235, 0.156853322938943643,
                                   0.181341891689180991,
                                   0.181341891689180991, 0.156853322938943643, 0.111190517226687235,
                                       0.050614268145188130};

/* A stretch between two values inside which nothing jumps or bends; halved until its depth is small. */
TEST_FN void oracle_stretch(const double f[4], const double b[4], double d, int independent, double sum[4]) {
    const double m = 0.5 * (f[3] + b[3]) * d;
    double a[4];
    int i, c;
    if (sum[3] < 1e-18) return;
    if (m > 0.5) {
        double mid[4];
        /* where the depth is about half: the geometric place would do too, this only has to end soon */
        double x = m > 8.0 ? 1.0 / m : 0.5;
        if (x < 1e-9) x = 1e-9;
        for (c = 0; c < 4; c++) mid[c] = f[c] + (b[c] - f[c]) * x;
        oracle_stretch(f, mid, d * x, independent, sum);
        oracle_stretch(mid, b, d * (1.0 - x), independent, sum);
        return;
    }
    memset(a, 0, sizeof a);
    for (i = 0; i < 8; i++) {
        const double x = oracle_x[i], tau = f[3] + (b[3] - f[3]) * x;
        const double left = exp(-d * (f[3] * x + 0.5 * (b[3] - f[3]) * x * x));
        for (c = 0; c < 3; c++) a[c] += oracle_w[i] * d * (f[c] + (b[c] - f[c]) * x) * (independent ? 1.0 : tau) * left;
    }
    for (c = 0; c < 3; c++) sum[c] += sum[3] * a[c];
    sum[3] *= exp(-m);
}

/* Colour and opacity of one segment: split at every point of the function between front and back. */
TEST_FN void oracle_segment(const tetcast_control_point *p, size_t n, int independent, const tetcast_segment *s,
                            double out[4]) {
    const double front = (double)s->front, back = (double)s->back;
    double sum[4] = {0.0, 0.0, 0.0, 1.0}, from = front;
    size_t k;
    int c;
    if (front == back) {
        double v[4];
        oracle_eval(p, n, front, 1, v);
        oracle_stretch(v, v, (double)s->length, independent, sum);
    } else {
        for (k = 0; k <= n; k++) {
            const size_t i = back > front ? k : n - 1 - k; /* k == n: the end of the segment */
            const double to = k == n ? back : (double)p[i].value;
            double f[4], b[4];
            if (k < n && !(back > front ? to > from && to < back : to < from && to > back)) continue;
            oracle_eval(p, n, from, back > front, f);
            oracle_eval(p, n, to, back <= front, b);
            oracle_stretch(f, b, (double)s->length * ((to - from) / (back - front)), independent, sum);
            from = to;
        }
    }
    for (c = 0; c < 3; c++) out[c] = sum[c];
    out[3] = 1.0 - sum[3];
}

/* The same by the midpoint rule with n steps: no splitting, no thought. */
TEST_FN void oracle_brute(const tetcast_control_point *p, size_t n, int independent, const tetcast_segment *s,
                          int steps,
                          double out[4]) {
    double t = 1.0, d = (double)s->length / steps;
    int i, c;
    memset(out, 0, 4 * sizeof *out);
    for (i = 0; i < steps; i++) {
        double v[4], a;
        oracle_eval(p, n, (double)s->front + ((double)s->back - (double)s->front) * (i + 0.5) / steps, 1, v);
        a = 1.0 - exp(-v[3] * d);
        for (c = 0; c < 3; c++) out[c] += t * v[c] * (independent ? (v[3] * d > 1e-12 ? a / v[3] : d) : a);
        t *= 1.0 - a;
    }
    out[3] = 1.0 - t;
}

#endif
