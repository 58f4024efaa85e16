/* voxrt_view.c - fly through a voxel file in a terminal with 24-bit colours
   SPDX-License-Identifier: MIT OR Unlicense

   A character shows two pixels: a half block in the colour of the upper one before the colour of the lower one. Only
   characters that changed are sent. A key press is a push: movement goes on for a moment and fades, so that the
   repeated keys of a terminal give an even flight. When nothing moves, rays are added until the picture has 16 a pixel. */
#include "support/cli.h"
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"
#include "support/voxel_file.h"
#include <poll.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <termios.h>

enum { STILL_SAMPLES = 16, KEY_BYTES = 256, LONGEST_CELL = 64, PAGES_A_FRAME = 8 << 20 /* bytes read of them */ };

typedef struct view_options {
    const char *in;
    int64_t threads, frames, memory;
    double budget, tolerance;
    uint32_t size[2];
    int has_size;
} view_options;

typedef struct viewer {
    voxrt_tree *tree;
    voxrt_paged *paged;     /* instead of it */
    voxrt_geometry pages;
    voxrt_render_desc desc;
    voxrt_image image;        /* rgba8 and sum of this frame */
    uint8_t (*shown)[8];      /* what each character of the terminal shows: upper and lower colour; [3]: 1 if known */
    char *out;                /* bytes for the terminal */
    size_t out_room, out_count;
    uint32_t columns, rows;   /* of the picture; one more row is for the keys */
    double position[3], yaw, pitch, push[3], turn[2], speed, size; /* push, turn: what still moves; size of the object */
    double home[5];           /* position, yaw and pitch at the start */
    voxrt_budget budget;
    uint32_t samples;         /* that `sum` holds */
    int coarse;               /* 1: they are not as fine as was asked for */
    int help, done;
    float ms, tolerance;      /* of the last frame that moved; for the next one */
} viewer;

static volatile sig_atomic_t stop_signal;
static void on_signal(int number) { stop_signal = number; }

/* ---- the terminal ---- */

static struct termios terminal_before;

static int terminal_open(void) {
    struct termios raw;
    struct sigaction action;
    if (!isatty(STDOUT_FILENO) || tcgetattr(STDIN_FILENO, &terminal_before) != 0) return 1;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_signal;
    (void)sigaction(SIGTERM, &action, NULL);
    (void)sigaction(SIGHUP, &action, NULL);
    (void)sigaction(SIGINT, &action, NULL);
    raw = terminal_before;
    raw.c_lflag &= ~(tcflag_t)(ECHO | ICANON | ISIG | IEXTEN);
    raw.c_iflag &= ~(tcflag_t)(IXON | ICRNL);
    raw.c_cc[VMIN] = 0;
    raw.c_cc[VTIME] = 0;
    return tcsetattr(STDIN_FILENO, TCSAFLUSH, &raw) != 0;
}

/* Write all; a terminal that is gone is no reason to stay. */
static void terminal_write(const char *text, size_t count) {
    while (count > 0) {
        const ssize_t n = write(STDOUT_FILENO, text, count);
        if (n < 0 && errno == EAGAIN) {
            struct pollfd p = {STDOUT_FILENO, POLLOUT, 0};
            (void)poll(&p, 1, 100);
        } else if (n < 0 && errno != EINTR) {
            stop_signal = SIGHUP;
            return;
        }
        if (stop_signal == SIGHUP) return;
        if (n > 0) {
            text += n;
            count -= (size_t)n;
        }
    }
}

static void terminal_say(const char *text) { terminal_write(text, strlen(text)); }

static void terminal_close(void) {
    terminal_say("\x1b[0m\x1b[?25h\x1b[?1049l");
    (void)tcsetattr(STDIN_FILENO, TCSAFLUSH, &terminal_before);
}

/* Columns and rows of the terminal, or what was asked for. */
static void terminal_size(const view_options *o, uint32_t out[2]) {
    struct winsize w;
    out[0] = 80;
    out[1] = 24;
    if (o->has_size) {
        out[0] = o->size[0];
        out[1] = o->size[1];
    } else if (ioctl(STDOUT_FILENO, TIOCGWINSZ, &w) == 0 && w.ws_col > 0 && w.ws_row > 0) {
        out[0] = w.ws_col;
        out[1] = w.ws_row;
    }
    if (out[0] > 1000) out[0] = 1000;
    if (out[1] > 500) out[1] = 500;
    if (out[1] < 2) out[1] = 2;
}

static void put(viewer *v, const char *text) {
    const size_t n = strlen(text);
    if (n > v->out_room - v->out_count) return;
    memcpy(v->out + v->out_count, text, n);
    v->out_count += n;
}

static void free_picture(viewer *v) {
    SUP_FREE(v->image.rgba8);
    SUP_FREE(v->image.sum);
    SUP_FREE(v->shown);
    SUP_FREE(v->out);
    v->image.rgba8 = NULL;
    v->image.sum = NULL;
    v->shown = NULL;
    v->out = NULL;
}

/* Buffers for a terminal of this size. Returns 1 when memory is short. */
static int make_picture(viewer *v, const uint32_t size[2]) {
    const uint32_t rows = size[1] - 1;
    const size_t cells = (size_t)size[0] * rows;
    if (v->shown != NULL && size[0] == v->columns && rows == v->rows) return 0;
    free_picture(v);
    v->columns = v->image.width = size[0];
    v->rows = rows;
    v->image.height = 2 * rows;
    v->out_room = LONGEST_CELL * cells + 4096;
    v->image.rgba8 = (uint8_t *)sup_alloc(2 * cells, 4);
    v->image.sum = (float *)sup_alloc(2 * cells, 4 * sizeof(float));
    v->shown = (uint8_t(*)[8])sup_alloc(cells, 8);
    v->out = (char *)sup_alloc(v->out_room, 1);
    v->samples = 0;
    if (v->image.rgba8 == NULL || v->image.sum == NULL || v->shown == NULL || v->out == NULL) return 1;
    memset(v->shown, 0, cells * 8);
    terminal_say("\x1b[0m\x1b[2J");
    return 0;
}

/* ---- the picture ---- */

static void direction(const viewer *v, double out[3]) {
    out[0] = sin(v->yaw) * cos(v->pitch);
    out[1] = sin(v->pitch);
    out[2] = -cos(v->yaw) * cos(v->pitch);
}

static void set_camera(viewer *v) {
    double d[3];
    direction(v, d);
    for (int a = 0; a < 3; a++) {
        v->desc.camera.eye[a] = (float)v->position[a];
        v->desc.camera.at[a] = (float)(v->position[a] + v->size * d[a]);
    }
}

/* Start where the whole object is seen. */
static int go_home(viewer *v) {
    double box_min[3], box_max[3], d[3], length = 0.0;
    voxrt_camera *c = &v->desc.camera;
    if (v->tree != NULL) voxrt_tree_bounds(v->tree, box_min, box_max);
    else memcpy(box_min, v->pages.box_min, sizeof box_min);
    if (v->tree == NULL) memcpy(box_max, v->pages.box_max, sizeof box_max);
    v->size = 0.0;
    for (int a = 0; a < 3; a++) v->size = fmax(v->size, box_max[a] - box_min[a]);
    if ((v->tree != NULL ? voxrt_camera_fit_tree(c, v->tree, NULL, v->image.width, v->image.height) :
         voxrt_camera_fit(c, box_min, box_max, NULL, v->image.width, v->image.height)) != VOXRT_OK) return 1;
    for (int a = 0; a < 3; a++) {
        d[a] = (double)c->at[a] - (double)c->eye[a];
        length += d[a] * d[a];
        v->position[a] = v->home[a] = (double)c->eye[a];
    }
    v->pitch = v->home[4] = asin(d[1] / sqrt(length));
    v->yaw = v->home[3] = atan2(d[0], -d[2]);
    v->speed = 1.0;
    return 0;
}

static void put_colors(viewer *v, const uint8_t *was, const uint8_t *now) {
    char text[LONGEST_CELL];
    if (was == NULL || memcmp(was, now, 3) != 0) {
        (void)snprintf(text, sizeof text, "\x1b[38;2;%d;%d;%dm", now[0], now[1], now[2]);
        put(v, text);
    }
    if (was == NULL || memcmp(was + 4, now + 4, 3) != 0) {
        (void)snprintf(text, sizeof text, "\x1b[48;2;%d;%d;%dm", now[4], now[5], now[6]);
        put(v, text);
    }
}

/* Send the characters that have changed. */
static void show(viewer *v) {
    const uint8_t *last = NULL; /* the colours that the terminal writes with */
    char text[LONGEST_CELL];
    v->out_count = 0;
    for (uint32_t y = 0; y < v->rows; y++) {
        uint32_t cursor = UINT32_MAX;
        for (uint32_t x = 0; x < v->columns; x++) {
            const uint8_t *upper = v->image.rgba8 + 4 * ((size_t)2 * y * v->columns + x);
            uint8_t *was = v->shown[(size_t)y * v->columns + x], now[8];
            memcpy(now, upper, 4);
            memcpy(now + 4, upper + 4 * (size_t)v->columns, 4);
            now[3] = 1;
            now[7] = 0;
            if (memcmp(was, now, 8) == 0) continue;
            if (cursor != x) {
                (void)snprintf(text, sizeof text, "\x1b[%u;%uH", y + 1, x + 1);
                put(v, text);
            }
            put_colors(v, last, now);
            memcpy(was, now, 8);
            last = was;
            put(v, "\xe2\x96\x80"); /* the upper half block */
            cursor = x + 1;
        }
    }
    (void)snprintf(text, sizeof text, "\x1b[0m\x1b[%u;1H", v->rows + 1);
    put(v, text);
    if (v->help) {
        char line[256];
        int n = snprintf(line, sizeof line,
                         "%5.1f ms  WASD move  E C up down  arrows look  + - speed  L shadows  V view  H home  ? keys  "
                         "Q quit", (double)v->ms);
        if (n > (int)v->columns - 1) line[v->columns - 1] = '\0'; /* the last column would scroll */
        put(v, line);
    }
    put(v, "\x1b[K");
    terminal_write(v->out, v->out_count);
}

/* Draw a frame as the budget allows, or, when nothing has moved, one that is as fine as asked for, or add rays to that.
   Returns what the library says. */
static voxrt_result draw(viewer *v, const view_options *o, int moved) {
    const double start = sup_now();
    voxrt_result result;
    set_camera(v);
    if (moved || v->coarse) v->samples = 0;
    v->desc.first_sample = v->samples;
    v->desc.samples = v->samples == 0 ? 1 : v->samples;
    v->desc.tolerance = moved ? v->tolerance : (float)o->tolerance;
    v->desc.pixel_step = moved ? v->budget.pixel_step : 1;
    v->coarse = v->desc.pixel_step > 1 || v->desc.tolerance > (float)o->tolerance;
    result = voxrt_render(&v->desc, v->tree, &v->image, NULL);
    if (result != VOXRT_OK) return result;
    v->samples += v->desc.samples;
    if (moved) {
        v->ms = (float)(1e3 * (sup_now() - start));
        v->tolerance = voxrt_budget_update(&v->budget, v->ms, (float)o->budget, (float)o->tolerance);
    }
    if (v->paged != NULL) { /* some of what the picture lacked; then it is drawn again */
        voxrt_paged_update_stats pages;
        (void)voxrt_paged_update(v->paged, PAGES_A_FRAME, &pages); /* what cannot be read stays coarse */
        if (pages.loaded != 0) v->coarse = 1;
    }
    show(v);
    return VOXRT_OK;
}

/* ---- keys ---- */

static void press(viewer *v, int key) {
    const double step = 0.02 * v->size * v->speed, angle = 0.06;
    switch (key) {
    case 'w': v->push[2] += step; break;
    case 's': v->push[2] -= step; break;
    case 'd': v->push[0] += step; break;
    case 'a': v->push[0] -= step; break;
    case 'e': case ' ': v->push[1] += step; break;
    case 'c': v->push[1] -= step; break;
    case 'A' - 64: v->turn[1] += angle; break; /* arrows: see read_keys */
    case 'B' - 64: v->turn[1] -= angle; break;
    case 'C' - 64: v->turn[0] += angle; break;
    case 'D' - 64: v->turn[0] -= angle; break;
    case '+': case '=': v->speed = fmin(64.0, v->speed * 1.5); break;
    case '-': v->speed = fmax(1.0 / 1024.0, v->speed / 1.5); break;
    case 'l': v->desc.shadows ^= 1u; break;
    case 'v':
        v->desc.view = v->desc.view == VOXRT_VIEW_SHADED   ? VOXRT_VIEW_UNLIT
                       : v->desc.view == VOXRT_VIEW_UNLIT ? VOXRT_VIEW_NORMALS
                       : v->desc.view == VOXRT_VIEW_NORMALS ? VOXRT_VIEW_HEAT_OUTER
                                                            : VOXRT_VIEW_SHADED;
        break;
    case 'h':
        memcpy(v->position, v->home, sizeof v->position);
        v->yaw = v->home[3];
        v->pitch = v->home[4];
        v->speed = 1.0;
        memset(v->push, 0, sizeof v->push);
        memset(v->turn, 0, sizeof v->turn);
        break;
    case '?': v->help = !v->help; break;
    case 'q': v->done = 1; break;
    default: break;
    }
}

/* Wait for keys for at most `ms` and take all there are. Returns 1 if there were any. */
static int read_keys(viewer *v, int ms) {
    struct pollfd p = {STDIN_FILENO, POLLIN, 0};
    char text[KEY_BYTES];
    ssize_t n;
    if (poll(&p, 1, ms) <= 0) return 0;
    n = read(STDIN_FILENO, text, sizeof text / 2);
    if (n <= 0) { /* the terminal is gone */
        v->done = 1;
        return 0;
    }
    if ((text[n - 1] == '\x1b' || (n > 1 && text[n - 2] == '\x1b')) && poll(&p, 1, 25) > 0) { /* the rest of an arrow */
        const ssize_t more = read(STDIN_FILENO, text + n, sizeof text / 2);
        if (more > 0) n += more;
    }
    for (ssize_t i = 0; i < n; i++) {
        const char c = text[i];
        if (c == '\x1b' && i + 2 < n && (text[i + 1] == '[' || text[i + 1] == 'O')) {
            if (text[i + 2] >= 'A' && text[i + 2] <= 'D') press(v, text[i + 2] - 64);
            i += 2;
        } else if (c == '\x1b' || c == 3) { /* Escape, Ctrl-C */
            v->done = 1;
        } else {
            press(v, c >= 'A' && c <= 'Z' ? c - 'A' + 'a' : c >= ' ' ? c : 0);
        }
    }
    return 1;
}

/* Move for `seconds`; pushes fade. Returns 1 while anything moves. */
static int move(viewer *v, double seconds) {
    const double fade = exp(-6.0 * seconds), share = 1.0 - fade;
    const double forward[2] = {sin(v->yaw), -cos(v->yaw)};
    double ahead[3], rest = 0.0;
    direction(v, ahead);
    for (int a = 0; a < 3; a++) v->position[a] += share * v->push[2] * ahead[a];
    v->position[0] -= share * v->push[0] * forward[1];
    v->position[2] += share * v->push[0] * forward[0];
    v->position[1] += share * v->push[1];
    v->yaw += share * v->turn[0];
    v->pitch = fmax(-1.5, fmin(1.5, v->pitch + share * v->turn[1]));
    for (int a = 0; a < 3; a++) {
        v->push[a] *= fade;
        rest = fmax(rest, fabs(v->push[a]) / (v->size * v->speed));
    }
    for (int a = 0; a < 2; a++) {
        v->turn[a] *= fade;
        rest = fmax(rest, fabs(v->turn[a]));
    }
    if (rest >= 1e-4) return 1;
    memset(v->push, 0, sizeof v->push);
    memset(v->turn, 0, sizeof v->turn);
    return 0;
}

/* ---- program ---- */

static voxrt_result fly(viewer *v, const view_options *o) {
    double before = sup_now();
    int64_t frame = 0;
    int moved = 1;
    voxrt_result result = VOXRT_OK;
    while (!v->done && stop_signal == 0) {
        const uint32_t width = v->columns, rows = v->rows;
        uint32_t size[2];
        int busy, keys;
        double now;
        terminal_size(o, size);
        if (make_picture(v, size)) return VOXRT_ERR_NO_MEMORY;
        moved |= v->columns != width || v->rows != rows;
        if (moved || v->coarse || v->samples < STILL_SAMPLES) {
            result = draw(v, o, moved);
            if (result != VOXRT_OK) return result;
            frame++;
        }
        if (o->frames != 0 && frame >= o->frames) break;
        busy = moved || v->coarse || v->samples < STILL_SAMPLES;
        keys = read_keys(v, busy ? 1 : 100);
        now = sup_now();
        moved = keys;
        moved |= move(v, fmin(0.1, now - before)); /* from standstill the first step is a short one */
        before = now;
    }
    return result;
}

int main(int argc, char **argv) {
    view_options o = {0};
    viewer v = {0};
    sup_option table[9];
    size_t n = 0;
    sup_error err;
    uint32_t size[2];
    voxrt_result result;
    int status;
    o.budget = 33.0;
    o.tolerance = 0.5;
    o.memory = 1024;
    table[n++] = sup_opt_positional("IN.vox", &o.in, 1, "voxel file, format 5 or 4");
    table[n++] = sup_opt_real("budget", &o.budget, 1.0, 1e5, "MS", "time of a frame; detail gives way (33)");
    table[n++] = sup_opt_real("tolerance", &o.tolerance, 0.0, 64.0, "E", "width of a voxel in pixels at most (0.5)");
    table[n++] = sup_opt_given(sup_opt_size("size", o.size, "characters; without it all of the terminal"), &o.has_size);
    table[n++] = sup_opt_int("frames", &o.frames, 0, INT64_C(1000000000), "N", "end after so many frames");
    table[n++] = sup_opt_int("memory", &o.memory, 1, 1048576, "MIB", "of a file in pages (voxrt_convert --paged): for what is loaded (1024)");
    table[n++] = sup_opt_int("threads", &o.threads, 0, 1024, "N", "threads, 0: one per core");
    status = sup_cli_parse(argc, argv, "Flies through a voxel file in a terminal with 24-bit colours.", table, n);
    if (status >= 0) return status;
    if (sup_voxels_paged(o.in, (uint64_t)o.memory << 20, 0, &v.paged, &err) ||
        (v.paged == NULL && sup_voxels_load(o.in, (uint32_t)o.threads, NULL, &v.tree, NULL, &err)))
        return sup_bad_input(argv[0], err.text);
    if (v.paged != NULL) {
        voxrt_paged_geometry(v.paged, &v.pages);
        v.desc.geometry = &v.pages;
        v.desc.geometry_count = 1;
    }
    stop_signal = 0;
    if (terminal_open()) {
        voxrt_paged_destroy(v.paged);
        voxrt_tree_destroy(v.tree);
        return sup_bad_input(argv[0], "standard input and output have to be a terminal");
    }
    terminal_say("\x1b[?1049h\x1b[?25l");
    v.help = 1;
    v.desc.env.thread_count = (uint32_t)o.threads;
    v.desc.background[0] = v.desc.background[1] = 0.01f;
    v.desc.background[2] = 0.03f;
    v.desc.background[3] = 1.0f;
    v.tolerance = (float)o.tolerance;
    terminal_size(&o, size);
    result = make_picture(&v, size) ? VOXRT_ERR_NO_MEMORY : go_home(&v) ? VOXRT_ERR_INVALID_ARG : fly(&v, &o);
    terminal_close();
    free_picture(&v);
    voxrt_paged_destroy(v.paged);
    voxrt_tree_destroy(v.tree);
    return result == VOXRT_OK ? 0 : sup_bad_input(argv[0], voxrt_result_string(result));
}
