/* osmesa_zbufrand.cpp - triangles and points drawn by zbufrand and by Mesa's llvmpipe - MIT OR Unlicense, see LICENSE

   peer_osmesa_zbufrand [--full] [--threads N]

   Same meshes with a normal for each vertex, same camera, same light worked out for each pixel, depth test, 1024 x 768. llvmpipe
   draws from buffers that it has already (indexed triangles, with and without culling; points of one pixel) into memory of
   ours. It has the caller's thread and N - 1 others. What is right is the mean of 256 rays a pixel in some of the tiles
   (bench_worlds.h): the error of both is the RMSE of sRGB values against it. */
#define GL_GLEXT_PROTOTYPES
#include "../bench.h"
#include "../../examples/support/mesh.h"
#include "../../examples/support/scenes.h"
#define ZBUFRAND_IMPLEMENTATION
#include "../../zbufrand.h"
#include "peer.h"
#include "../../examples/support/worlds.h"
#include "../bench_worlds.h"
#include <GL/osmesa.h>
#include <GL/gl.h>
#include <GL/glext.h>

enum { ROUNDS = 5, WIDTH = 1024, HEIGHT = 768 };
static const char *const g_isa = zbufrand_isa_name(zbufrand_isa_best());
static const char *const g_rmse = "RMSE of sRGB to 256 rays a pixel";
static char g_mesa[64] = "llvmpipe";

/* ---- OpenGL ---- */

static OSMesaContext g_context;
static std::vector<uint32_t> g_pixels(WIDTH * HEIGHT);
static GLuint g_program;

static GLuint shader(GLenum kind, const char *text) {
    const GLuint s = glCreateShader(kind);
    GLint done = 0;
    glShaderSource(s, 1, &text, nullptr);
    glCompileShader(s);
    glGetShaderiv(s, GL_COMPILE_STATUS, &done);
    if (!done) run_failed("shader", "does not compile");
    return s;
}

static void gl_open(void) {
    static const int want[] = {OSMESA_FORMAT, OSMESA_RGBA, OSMESA_DEPTH_BITS, 24, OSMESA_PROFILE, OSMESA_CORE_PROFILE,
                               OSMESA_CONTEXT_MAJOR_VERSION, 3, OSMESA_CONTEXT_MINOR_VERSION, 3, 0};
    GLuint array;
    g_context = OSMesaCreateContextAttribs(want, nullptr);
    if (g_context == nullptr || !OSMesaMakeCurrent(g_context, g_pixels.data(), GL_UNSIGNED_BYTE, WIDTH, HEIGHT)) run_failed("OSMesa", "no context");
    OSMesaPixelStore(OSMESA_Y_UP, 0);
    const char *version = strstr((const char *)glGetString(GL_VERSION), "Mesa");
    snprintf(g_mesa, sizeof g_mesa, "llvmpipe (%s)", version != nullptr ? version : "Mesa");
    g_program = glCreateProgram();
    glAttachShader(g_program, shader(GL_VERTEX_SHADER, "#version 330\nuniform mat4 P;uniform vec4 e;layout(location=0)in vec3 a;layout(location=1)in vec3 n;"
        "out vec3 q;void main(){gl_Position=P*vec4(a,1);q=n;if(e.w>0.0&&dot(n,e.xyz-a)<0.0)gl_Position=vec4(2,2,2,1);}"));
    glAttachShader(g_program, shader(GL_FRAGMENT_SHADER, "#version 330\nuniform vec3 L;uniform vec2 w;in vec3 q;out vec4 o;"
        "void main(){o=vec4(vec3(w.x+w.y*max(0.0,dot(normalize(q),L))),1);}"));
    glLinkProgram(g_program);
    glUseProgram(g_program);
    glViewport(0, 0, WIDTH, HEIGHT);
    glEnable(GL_DEPTH_TEST);
    glClearColor(g_sky[0], g_sky[1], g_sky[2], 1);
    glGenVertexArrays(1, &array);
    glBindVertexArray(array);
    glEnableVertexAttribArray(0);
    glEnableVertexAttribArray(1);
    glUniform3f(glGetUniformLocation(g_program, "L"), (float)g_light[0], (float)g_light[1], (float)g_light[2]);
    glUniform2f(glGetUniformLocation(g_program, "w"), g_ambient, g_light_color);
}

/* The library's camera as a matrix, column by column. points: those that face away are left out. */
static void gl_camera(const picture_job *p, bool points) {
    zbufrandi_camera c;
    const double near_z = 0.05, far_z = 50.0;
    float m[16];
    double row[4][4];
    must(zbufrandi_camera_open(&p->desc.camera, p->scene, WIDTH, HEIGHT, 0, &c), "camera");
    const double *axis[3] = {c.right, c.up, c.dir};
    const double scale[2] = {2.0 * c.focal / WIDTH, 2.0 * c.focal / HEIGHT};
    memset(row, 0, sizeof row);
    for (int a = 0; a < 3; a++) {
        double view[4] = {axis[a][0], axis[a][1], axis[a][2], 0};
        for (int k = 0; k < 3; k++) view[3] -= axis[a][k] * c.eye[k];
        for (int k = 0; k < 4; k++) {
            if (a < 2) row[a][k] = scale[a] * view[k];
            if (a == 2) {
                row[2][k] = (far_z + near_z) / (far_z - near_z) * view[k];
                row[3][k] = view[k];
            }
        }
    }
    row[2][3] -= 2.0 * far_z * near_z / (far_z - near_z);
    for (int i = 0; i < 16; i++) m[i] = (float)row[i % 4][i / 4];
    glUniformMatrix4fv(glGetUniformLocation(g_program, "P"), 1, GL_FALSE, m);
    glUniform4f(glGetUniformLocation(g_program, "e"), (float)c.eye[0], (float)c.eye[1], (float)c.eye[2], points ? 1.0f : 0.0f);
}

struct gl_mesh {
    GLuint buffer[3];
    size_t vertices, indices;
    double bytes;

    gl_mesh(const float *positions, const float *normals, size_t nv, const uint32_t *index, size_t ni) : vertices(nv), indices(ni) {
        glGenBuffers(3, buffer);
        for (GLuint i = 0; i < 2; i++) {
            glBindBuffer(GL_ARRAY_BUFFER, buffer[i]);
            glBufferData(GL_ARRAY_BUFFER, (GLsizeiptr)(12 * nv), i == 0 ? positions : normals, GL_STATIC_DRAW);
            glVertexAttribPointer(i, 3, GL_FLOAT, 0, 0, nullptr);
        }
        glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, buffer[2]);
        glBufferData(GL_ELEMENT_ARRAY_BUFFER, (GLsizeiptr)(4 * ni), index, GL_STATIC_DRAW);
        bytes = 24.0 * (double)nv + 4.0 * (double)ni;
    }
    ~gl_mesh() { glDeleteBuffers(3, buffer); }
    gl_mesh(const gl_mesh &) = delete;
    gl_mesh &operator=(const gl_mesh &) = delete;

    void draw(bool cull) const {
        if (cull) glEnable(GL_CULL_FACE);
        else glDisable(GL_CULL_FACE);
        glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
        if (indices != 0) glDrawElements(GL_TRIANGLES, (GLsizei)indices, GL_UNSIGNED_INT, nullptr);
        else glDrawArrays(GL_POINTS, 0, (GLsizei)vertices);
        glFinish();
    }
};

static double gl_error(const truth *t) {
    std::vector<float> rgba(4 * g_pixels.size());
    for (size_t i = 0; i < g_pixels.size(); i++)
        for (size_t a = 0; a < 4; a++) rgba[4 * i + a] = (float)((const uint8_t *)&g_pixels[i])[a] / 255.0f;
    return judge(t, rgba.data(), nullptr, nullptr, nullptr).rmse;
}

/* ---- triangles ---- */

static world *mesh_world(const char *name, supi_make *make, bool hall) {
    world *w = world_open(name, (uint32_t)g_opt.threads);
    sup_error err;
    if (make->failed || sup_mesh_compute_normals(&make->mesh, &err)) run_failed(name, "cannot be made");
    (void)supi_world_mesh(&w->w, make, ZBUFRAND_ROOT, 0, 0, 0);
    world_build(w);
    if (hall) world_view(w, -7.7, 0.9, -7.4, 0.5, -0.4, 0.7, 60);
    else world_view(w, 0.9, 0.8, 2.4, 0, 0, 0, 50);
    return w;
}

static void triangles(const char *kase, bool hall, int rows) {
    supi_make make;
    memset(&make, 0, sizeof make);
    if (hall) supi_make_hall(&make, rows);
    else make = blob_mesh(rows);
    world *w = mesh_world(kase, &make, hall);
    const sup_mesh *m = &w->w.meshes[0];
    const double count = (double)m->triangle_count;
    picture_job raster = picture_open(w, WIDTH, HEIGHT, (uint32_t)g_peer_threads), plain = picture_open(w, WIDTH, HEIGHT, (uint32_t)g_peer_threads);
    truth *t = truth_make(&plain, 16);
    const gl_mesh gl(m->positions, m->normals, m->vertex_count, m->indices, 3 * m->triangle_count);
    peer_side p[4] = {peer_ours("zbufrand_render, all rastered", g_isa), peer_theirs(g_mesa, "indexed triangles"),
                      peer_theirs(g_mesa, "indexed triangles, back faces culled"), peer_ours("zbufrand_render", g_isa)};
    gl_camera(&plain, false);
    picture_raster(&raster, 1);
    p[0].run = [&] { picture_run(&raster); };
    p[1].run = [&] { gl.draw(false); };
    p[2].run = [&] { gl.draw(true); };
    p[3].run = [&] { picture_run(&plain); };
    peer_time(p, 4, ROUNDS);
    for (int i = 1; i < 3; i++) {
        p[i].run();
        p[i].error = gl_error(t);
        p[i].bytes = gl.bytes;
        p[i].bytes_each = gl.bytes / count;
    }
    for (int i = 0; i < 4; i += 3) {
        const picture_job &j = i == 0 ? raster : plain;
        const wrong e = judge(t, j.image.rgba, nullptr, j.image.depth, nullptr);
        p[i].error = e.rmse;
        p[i].holes = 100.0 * e.holes;
        p[i].bytes = (double)w->info.bytes + (double)j.stats.bytes;
        p[i].bytes_each = (double)w->info.bytes / count;
        p[i].hash = picture_hash(&j);
    }
    const std::string text = kase;
    peer_lines("Z3", (text + ", our rasteriser").c_str(), "frame_seconds", "s", 0, g_rmse, p, 3);
    std::swap(p[0], p[3]);
    peer_lines("Z3", (text + ", our default").c_str(), "frame_seconds", "s", 0, g_rmse, p, 3);
    truth_free(t);
    picture_free(&raster);
    picture_free(&plain);
    world_free(w);
}

/* ---- points ---- */

static void points(void) {
    const size_t count = (size_t)4 << 20;
    supi_make make = blob_mesh(512);
    world *w = mesh_world("blob, points", &make, false);
    std::vector<float> position(3 * count), normal(3 * count), none;
    zbufrand_points cloud;
    picture_job own = picture_open(w, WIDTH, HEIGHT, (uint32_t)g_peer_threads), stored = picture_open(w, WIDTH, HEIGHT, (uint32_t)g_peer_threads);
    truth *t = truth_make(&own, 16);
    must(zbufrand_surface_points(w->w.scene, nullptr, count, position.data(), normal.data(), nullptr, nullptr), "points");
    memset(&cloud, 0, sizeof cloud);
    cloud.positions = position.data();
    cloud.normals = normal.data();
    cloud.count = count;
    const gl_mesh gl(position.data(), normal.data(), count, nullptr, 0);
    gl_camera(&own, true);
    own.scene = nullptr;
    own.desc.points = &cloud;
    own.desc.points_count = 1;
    stored.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    peer_side p[2] = {peer_ours("zbufrand_render, own points", g_isa), peer_theirs(g_mesa, "GL_POINTS, 1 pixel")};
    p[0].run = [&] { picture_run(&own); };
    p[1].run = [&] { gl.draw(false); };
    peer_time(p, 2, ROUNDS);
    p[0].error = judge(t, own.image.rgba, nullptr, nullptr, nullptr).rmse;
    p[1].error = gl_error(t);
    for (int i = 0; i < 2; i++) {
        p[i].bytes_each = 24.0;
        p[i].bytes = 24.0 * (double)count;
    }
    peer_lines("Z2", "4.2 M points with normals, given", "points_per_second", "1/s", (double)count, g_rmse, p, 2);

    /* samples that the scene stores: whole frames, for as many points */
    p[0] = peer_ours("zbufrand_render, stored samples, whole frame", g_isa);
    p[0].run = [&] { picture_run(&stored); };
    p[1].seconds.clear();
    peer_time(p, 2, ROUNDS);
    for (double &k : p[0].seconds) k *= (double)count / (double)(stored.stats.samples[0] + stored.stats.samples[1]);
    p[0].error = judge(t, stored.image.rgba, nullptr, nullptr, nullptr).rmse;
    p[0].bytes = (double)w->info.bytes;
    p[0].bytes_each = (double)w->info.bytes / (double)w->info.stored_triangles;
    peer_lines("Z2", "samples of blob, 1.05 M triangles, against those points", "points_per_second", "1/s", (double)count, g_rmse, p, 2);

    /* where the points come from; nobody else's here makes any */
    p[0] = peer_ours("zbufrand_surface_points", g_isa);
    p[0].run = [&] {
        peer_for((size_t)g_peer_threads, 1, [&](size_t first, size_t) {
            zbufrand_surface_points_desc d;
            const size_t part = count / (size_t)g_peer_threads;
            memset(&d, 0, sizeof d);
            d.first = first * part;
            must(zbufrand_surface_points(w->w.scene, &d, part, position.data() + 3 * first * part, normal.data() + 3 * first * part, nullptr, nullptr),
                 "points");
        });
    };
    peer_time(p, 1, ROUNDS);
    double mean[2][3] = {{0, 0, 0}, {0, 0, 0}}, off = 0;
    for (size_t i = 0; i < count; i++)
        for (size_t a = 0; a < 3; a++) {
            mean[0][a] += (double)position[3 * i + a] / (double)count;
            if (2 * i < count) mean[1][a] += 2.0 * (double)position[3 * i + a] / (double)count;
        }
    for (int a = 0; a < 3; a++) off += (mean[0][a] - mean[1][a]) * (mean[0][a] - mean[1][a]);
    p[0].error = sqrt(off);
    p[0].bytes_each = 24.0;
    peer_lines("Z1", "random points of blob, position and normal", "points_per_second", "1/s", (double)count,
               "distance of the centre of the first half from that of all", p, 1);
    truth_free(t);
    picture_free(&own);
    picture_free(&stored);
    world_free(w);
}

/* ---- whether samples are fair ---- */

static std::vector<double> areas(const sup_mesh *m) {
    std::vector<double> area(m->triangle_count);
    for (size_t i = 0; i < area.size(); i++) {
        const uint32_t *v = m->indices + 3 * i;
        double e[2][3], x[3];
        for (size_t a = 0; a < 3; a++)
            for (size_t k = 0; k < 2; k++) e[k][a] = (double)m->positions[3 * (size_t)v[k + 1] + a] - (double)m->positions[3 * (size_t)v[0] + a];
        for (int a = 0; a < 3; a++) x[a] = e[0][(a + 1) % 3] * e[1][(a + 2) % 3] - e[0][(a + 2) % 3] * e[1][(a + 1) % 3];
        area[i] = 0.5 * sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    }
    return area;
}

/* Standard deviations of chi squared that the points on each triangle are from its share of the area. */
static double deviation(const std::vector<double> &area, const std::vector<double> &hits, double points) {
    double all = 0, chi = 0, freedom = -1;
    for (double a : area) all += a;
    for (size_t i = 0; i < area.size(); i++) {
        const double expected = area[i] / all * points;
        if (!(expected > 0)) continue;
        chi += (hits[i] - expected) * (hits[i] - expected) / expected;
        freedom += 1;
    }
    return (chi - freedom) / sqrt(2.0 * freedom);
}

/* off: standard deviations, negative if points are more even than by chance. What is judged of independent points is how far they
   are off either way; of stratified ones, which are more even by design, a larger chi squared alone. */
static void fair_line(const char *kase, bool independent, double off) {
    peer_side p = peer_ours(independent ? "zbufrand_surface_points, independent" : "zbufrand_surface_points, stratified", g_isa);
    p.value = independent ? fabs(off) : off;
    p.error = off;
    peer_lines("Z9", kase, "deviations", "sigma", 0, "standard deviations of chi squared; below 0: more even than by chance", &p, 1);
}

/* Of 10^8 points and of their prefixes of 2^17, 2^18 ...: independent ones of two seeds, stratified ones of one. */
static void fairness(void) {
    enum { PART = 1 << 17, PARTS = 763 };
    supi_make make = blob_mesh(64);
    world *w = mesh_world("blob, fairness", &make, false);
    const std::vector<double> area = areas(&w->w.meshes[0]);
    zbufrand_build_desc b;
    std::vector<float> position(3 * PART);
    std::vector<uint32_t> triangle(2 * PART);
    double all = 0, prefix[2] = {0, -1e9}; /* the farthest off: all points, prefixes of independent and of stratified ones */
    memset(&b, 0, sizeof b);
    b.ids = 1;
    must(zbufrand_scene_build(w->w.scene, &b, nullptr), "build");
    for (uint32_t run = 0; run < 3; run++) {
        std::vector<double> hits(area.size(), 0.0);
        for (uint32_t k = 0; k < PARTS; k++) {
            zbufrand_surface_points_desc d;
            memset(&d, 0, sizeof d);
            d.independent = run < 2;
            d.seed = run % 2;
            d.first = (uint64_t)k * PART;
            must(zbufrand_surface_points(w->w.scene, &d, PART, position.data(), nullptr, nullptr, triangle.data()), "points");
            for (size_t i = 0; i < PART; i++) hits[triangle[2 * i + 1]] += 1.0;
            if ((k & (k + 1)) != 0 && k + 1 != PARTS) continue;
            const double off = deviation(area, hits, (double)(k + 1) * PART);
            if (run < 2 && k + 1 == PARTS && fabs(off) > fabs(all)) all = off;
            if (run < 2 ? fabs(off) > fabs(prefix[0]) : off > prefix[1]) prefix[run / 2] = off;
        }
    }
    fair_line("chi squared of 10^8 points, by triangle, worse of two seeds", true, all);
    fair_line("the largest of every prefix of 2^17, 2^18 to 10^8, two seeds", true, prefix[0]);
    fair_line("the largest of every prefix, stratified", false, prefix[1]);
    world_free(w);
}

/* RMSE of two pictures, linear light. */
static double difference(const std::vector<float> &a, const float *b) {
    double sum = 0;
    for (size_t i = 0; i < a.size(); i++) if (i % 4 != 3) sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
    return sqrt(sum / (0.75 * (double)a.size()));
}

static void exponent_line(const char *kase, const char *error_unit, const double *error, int steps) {
    std::string method = "zbufrand_render, independent; 1, 4, 16 ... frames: ";
    char text[32];
    for (int i = 0; i < steps; i++) {
        snprintf(text, sizeof text, "%s%.4f", i > 0 ? ", " : "", error[i]);
        method += text;
    }
    peer_side s = peer_ours(method.c_str(), g_isa);
    s.value = log(error[0] / error[steps - 1]) / log((double)(1u << 2 * (steps - 1)));
    s.error = error[steps - 1];
    peer_lines("Z9", kase, "exponent", "", 0, error_unit, &s, 1);
}

/* How fast the error of a mean of frames falls with their number N: the exponent, 0.5 for 1/sqrt(N). Against rays, which are
   no part of the samples, and against the mean of 256 other frames, which tells the noise alone. All sampled, independent
   points, no repair by rays. */
static void mean_frames(void) {
    enum { STEPS = 4 };
    supi_make make = blob_mesh(512);
    world *w = mesh_world("blob, means", &make, false);
    picture_job p = picture_open(w, WIDTH, HEIGHT, (uint32_t)g_opt.threads);
    truth *t = truth_make(&p, 16);
    std::vector<float> many(4 * WIDTH * HEIGHT);
    double error[STEPS], noise[STEPS];
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    p.desc.independent = 1;
    p.desc.no_repair = 1;
    p.desc.frame = 1000;
    p.mean = 256;
    picture_run(&p);
    memcpy(many.data(), p.image.rgba, many.size() * sizeof many[0]);
    p.desc.frame = 0;
    for (uint32_t k = 0; k < STEPS; k++) {
        p.mean = 1u << 2 * k;
        picture_run(&p);
        error[k] = judge(t, p.image.rgba, nullptr, nullptr, nullptr).rmse;
        noise[k] = difference(many, p.image.rgba);
    }
    exponent_line("exponent of the fall of the error of a mean of frames, 1 to 64", g_rmse, error, STEPS);
    exponent_line("exponent of the fall of its noise, 1 to 16", "RMSE of linear light to 256 other frames", noise, STEPS - 1);
    truth_free(t);
    picture_free(&p);
    world_free(w);
}

int main(int argc, char **argv) {
    const int status = peer_parse(argc, argv, &g_opt);
    char threads[16];
    if (status) return status;
    peer_machine("osmesa_zbufrand", argv[0], "zbufrand.h", zbufrand_version());
    snprintf(threads, sizeof threads, "%d", g_peer_threads - 1);
    setenv("LP_NUM_THREADS", threads, 1);
    gl_open();
    triangles("blob, 1.05 M triangles", false, 512);
    triangles("blob, 8.4 M triangles", false, 1448);
    if (g_peer_threads == 1 || g_opt.full) triangles("hall, 8.4 M triangles", true, 1448);
    points();
    if (g_peer_threads == 1) {
        fairness();
        mean_frames();
    }
    OSMesaDestroyContext(g_context);
    return 0;
}
