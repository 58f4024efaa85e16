/* test_view.c - the terminal viewer, driven through a pseudo-terminal: what a small terminal makes of its output
   SPDX-License-Identifier: MIT OR Unlicense */
#define _XOPEN_SOURCE 700
#define _POSIX_C_SOURCE 200809L
#define _DEFAULT_SOURCE
#include "test.h"
#include <fcntl.h>
#include <sys/wait.h>
#define main voxrt_view_main
int main(int argc, char **argv);
#include "../examples/voxrt_view.c"
#undef main

/* ---- a terminal that knows what the viewer uses ---- */

enum { MOST_COLUMNS = 200, MOST_ROWS = 100 };

typedef struct cell {
    char text[4]; /* one character, UTF-8 */
    int fore[3], back[3];
} cell;

typedef struct terminal {
    cell at[MOST_ROWS][MOST_COLUMNS];
    int row, column, fore[3], back[3];
    int other_screen, cursor_hidden, unknown; /* unknown: sequences that it does not know */
    char pending[256];
    size_t pending_count;
    size_t bytes;
} terminal;

static void erase(terminal *t, int row, int from) {
    for (int x = from; x < MOST_COLUMNS; x++) {
        memset(&t->at[row][x], 0, sizeof t->at[row][x]);
        t->at[row][x].text[0] = ' ';
    }
}

static void sequence(terminal *t, const char *text, char last) {
    int number[16], count = 0;
    const char *p = text;
    if (*p == '?') {
        const int n = atoi(p + 1);
        if (n == 1049 && (last == 'h' || last == 'l')) t->other_screen = last == 'h';
        else if (n == 25 && (last == 'h' || last == 'l')) t->cursor_hidden = last == 'l';
        else t->unknown++;
        return;
    }
    while (*p != '\0' && count < 16) {
        number[count++] = atoi(p);
        p += strspn(p, "0123456789");
        if (*p == ';') p++;
        else if (*p != '\0') t->unknown++, p++;
    }
    if (last == 'H' && count == 2) {
        t->row = number[0] - 1;
        t->column = number[1] - 1;
    } else if (last == 'J' && count == 1 && number[0] == 2) {
        for (int y = 0; y < MOST_ROWS; y++) erase(t, y, 0);
    } else if (last == 'K' && count == 0) {
        erase(t, t->row, t->column);
    } else if (last == 'm' && count == 1 && number[0] == 0) {
        memset(t->fore, 0, sizeof t->fore);
        memset(t->back, 0, sizeof t->back);
    } else if (last == 'm' && count == 5 && number[1] == 2 && (number[0] == 38 || number[0] == 48)) {
        memcpy(number[0] == 38 ? t->fore : t->back, number + 2, 3 * sizeof(int));
    } else {
        t->unknown++;
    }
}

static void feed(terminal *t, const char *text, size_t n) {
    t->bytes += n;
    for (size_t i = 0; i < n; i++) {
        const unsigned char c = (unsigned char)text[i];
        const size_t k = t->pending_count;
        if (k == 0 && c != 0x1b && c < 0x80) {
            if (t->row >= 0 && t->row < MOST_ROWS && t->column >= 0 && t->column < MOST_COLUMNS) {
                cell *at = &t->at[t->row][t->column++];
                memset(at->text, 0, 4);
                at->text[0] = (char)c;
            }
            continue;
        }
        if (k + 1 >= sizeof t->pending) t->unknown++, t->pending_count = 0;
        t->pending[t->pending_count++] = (char)c;
        if (t->pending[0] == 0x1b) {
            if (t->pending_count < 3 || c < 0x40 || c > 0x7e) continue;
            t->pending[t->pending_count - 1] = '\0';
            if (t->pending[1] == '[') sequence(t, t->pending + 2, (char)c);
            else t->unknown++;
            t->pending_count = 0;
        } else if (t->pending_count == 3) { /* all that it sends is three bytes long */
            if (t->row >= 0 && t->row < MOST_ROWS && t->column >= 0 && t->column < MOST_COLUMNS) {
                cell *at = &t->at[t->row][t->column++];
                memcpy(at->text, t->pending, 3);
                at->text[3] = '\0';
                memcpy(at->fore, t->fore, sizeof at->fore);
                memcpy(at->back, t->back, sizeof at->back);
            } else {
                t->unknown++;
            }
            t->pending_count = 0;
        }
    }
}

/* ---- the viewer in it ---- */

typedef struct session {
    terminal screen;
    int master, status; /* status: of the program when it has ended, else -1 */
    pid_t child;
    struct termios before;
} session;

static void set_window(int fd, int columns, int rows) {
    struct winsize w;
    memset(&w, 0, sizeof w);
    w.ws_col = (unsigned short)columns;
    w.ws_row = (unsigned short)rows;
    (void)ioctl(fd, TIOCSWINSZ, &w);
}

/* Returns 1 when this machine has no pseudo-terminals. */
static int start(session *s, const char *file, int columns, int rows, const char *option, const char *value) {
    const char *name;
    memset(s, 0, sizeof *s);
    s->status = -1;
    s->master = posix_openpt(O_RDWR | O_NOCTTY);
    if (s->master < 0 || grantpt(s->master) != 0 || unlockpt(s->master) != 0) return 1;
    name = ptsname(s->master);
    if (name == NULL) return 1;
    set_window(s->master, columns, rows);
    (void)fflush(NULL);
    s->child = fork();
    if (s->child < 0) return 1;
    if (s->child == 0) {
        char program[] = "voxrt_view", in[512], opt[64], val[64];
        char *argv[5] = {program, in, opt, val, NULL};
        int fd, status;
        (void)snprintf(in, sizeof in, "%s", file);
        (void)snprintf(opt, sizeof opt, "%s", option);
        (void)snprintf(val, sizeof val, "%s", value);
        (void)setsid();
        fd = open(name, O_RDWR);
        (void)dup2(fd, 0);
        (void)dup2(fd, 1);
        status = voxrt_view_main(4, argv);
        (void)close(fd);
        (void)close(0);
        (void)close(1);
        (void)close(s->master);
        _exit(status);
    }
    for (int y = 0; y < MOST_ROWS; y++) erase(&s->screen, y, 0);
    return 0;
}

/* Take output until there was none for `quiet` ms; `first` ms for the first of it. At most 20 s. */
static void take(session *s, int first, int quiet) {
    const double end = sup_now() + 20.0;
    char text[4096];
    int wait = first;
    while (sup_now() < end) {
        struct pollfd p = {s->master, POLLIN, 0};
        ssize_t n;
        if (poll(&p, 1, wait) <= 0) return;
        wait = quiet;
        n = read(s->master, text, sizeof text);
        if (n <= 0) return;
        feed(&s->screen, text, (size_t)n);
    }
}

static void type(session *s, const char *keys) { CHECK(write(s->master, keys, strlen(keys)) == (ssize_t)strlen(keys)); }

static void finish(session *s) {
    const double end = sup_now() + 20.0;
    int status = 0;
    while (sup_now() < end) {
        take(s, 20, 20);
        if (waitpid(s->child, &status, WNOHANG) == s->child) {
            s->status = WIFEXITED(status) ? WEXITSTATUS(status) : 128;
            take(s, 20, 20);
            break;
        }
    }
    if (s->status < 0) {
        (void)kill(s->child, SIGKILL);
        (void)waitpid(s->child, &status, 0);
    }
    (void)close(s->master);
}

static void save_ball(const char *path) {
    voxrt_voxel *voxel = (voxrt_voxel *)calloc(32 * 32 * 32, sizeof *voxel);
    voxrt_tree *tree = NULL;
    size_t n = 0;
    REQUIRE(voxel != NULL);
    for (uint32_t i = 0; i < 32 * 32 * 32; i++) {
        const int x = (int)(i & 31) - 16, y = (int)(i >> 5 & 31) - 16, z = (int)(i >> 10) - 16;
        if (x * x + y * y + z * z > 200) continue;
        voxel[n].x = i & 31;
        voxel[n].y = i >> 5 & 31;
        voxel[n].z = i >> 10;
        voxel[n].rgb[0] = x < 0 ? 250 : 20; /* red to the left, green to the right */
        voxel[n++].rgb[1] = x < 0 ? 20 : 250;
    }
    CHECK(voxrt_tree_from_voxels(NULL, voxel, n, 5, &tree) == VOXRT_OK);
    free(voxel);
    REQUIRE(tree != NULL);
    CHECK(voxrt_tree_save_file(tree, NULL, path) == VOXRT_OK);
    voxrt_tree_destroy(tree);
}

/* Pixels that are more red than green, and the other way round, in the first `columns` of `rows` lines. */
static void count_colors(const terminal *t, int columns, int rows, int *red, int *green, int *other) {
    *red = *green = *other = 0;
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++) {
            const cell *c = &t->at[y][x];
            if (strcmp(c->text, "\xe2\x96\x80") != 0) (*other)++;
            *red += (c->fore[0] > c->fore[1] + 20) + (c->back[0] > c->back[1] + 20);
            *green += (c->fore[1] > c->fore[0] + 20) + (c->back[1] > c->back[0] + 20);
        }
}

static int same_picture(const terminal *a, const terminal *b, int columns, int rows) {
    for (int y = 0; y < rows; y++)
        for (int x = 0; x < columns; x++)
            if (memcmp(&a->at[y][x], &b->at[y][x], sizeof a->at[y][x]) != 0) return 0;
    return 1;
}

static char ball_path[64];

TEST(flies) {
    static session s;
    static terminal first;
    int red, green, other, red2, green2;
    REQUIRE(ball_path[0] != '\0');
    if (start(&s, ball_path, 60, 21, "--threads", "1")) SKIP("no pseudo-terminal");
    take(&s, 9000, 400);
    CHECK(s.screen.other_screen && s.screen.cursor_hidden && s.screen.unknown == 0);
    count_colors(&s.screen, 60, 20, &red, &green, &other);
    CHECK_EQ_I64(other, 0); /* all of the picture is half blocks */
    CHECK_MSG(red > 100 && green > 100, "%d red, %d green of 2400 pixels", red, green);
    CHECK(strcmp(s.screen.at[20][10].text, "W") == 0); /* the keys */
    first = s.screen;
    take(&s, 300, 300);
    CHECK_EQ_U64(s.screen.bytes, first.bytes); /* nothing moves: nothing is sent */

    type(&s, "dddd"); /* to the right: the red half leaves to the left, the ball is still there */
    take(&s, 9000, 400);
    CHECK(!same_picture(&s.screen, &first, 60, 20));
    count_colors(&s.screen, 60, 20, &red2, &green2, &other);
    CHECK_MSG(red2 < red, "%d red before, %d after", red, red2);
    type(&s, "h");
    take(&s, 9000, 400);
    CHECK(same_picture(&s.screen, &first, 60, 20)); /* home: the picture is the first one */

    type(&s, "\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C\x1b[C"); /* look away */
    take(&s, 9000, 400);
    count_colors(&s.screen, 60, 20, &red, &green, &other);
    CHECK_MSG(red + green < red2 + green2, "%d pixels of the ball before, %d after", red2 + green2, red + green);
    CHECK(waitpid(s.child, &red, WNOHANG) == 0);
    type(&s, "q");
    finish(&s);
    CHECK_EQ_I64(s.status, 0);
    CHECK(!s.screen.other_screen && !s.screen.cursor_hidden && s.screen.unknown == 0);
}

TEST(follows_the_window) {
    static session s;
    int red, green, other;
    REQUIRE(ball_path[0] != '\0');
    if (start(&s, ball_path, 40, 12, "--threads", "1")) SKIP("no pseudo-terminal");
    take(&s, 9000, 400);
    count_colors(&s.screen, 40, 11, &red, &green, &other);
    CHECK_EQ_I64(other, 0);
    set_window(s.master, 90, 31);
    take(&s, 9000, 400);
    count_colors(&s.screen, 90, 30, &red, &green, &other);
    CHECK_EQ_I64(other, 0);
    CHECK_MSG(red > 300 && green > 300, "%d red, %d green of 5400 pixels", red, green);
    set_window(s.master, 1, 1); /* nothing to see, no harm */
    take(&s, 3000, 200);
    set_window(s.master, 20, 5);
    take(&s, 3000, 200);
    CHECK_EQ_I64(s.screen.unknown, 0);
    CHECK(kill(s.child, SIGTERM) == 0); /* leaves the terminal as it was */
    finish(&s);
    CHECK_EQ_I64(s.status, 0);
    CHECK(!s.screen.other_screen && !s.screen.cursor_hidden);
}

TEST(ends) {
    static session s;
    REQUIRE(ball_path[0] != '\0');
    if (start(&s, ball_path, 40, 12, "--frames", "3")) SKIP("no pseudo-terminal");
    finish(&s);
    CHECK_EQ_I64(s.status, 0);
    CHECK(s.screen.bytes > 1000);
    if (start(&s, "/nonexistent.vox", 40, 12, "--frames", "3")) SKIP("no pseudo-terminal");
    finish(&s);
    CHECK_EQ_I64(s.status, 1);
    CHECK_EQ_U64(s.screen.bytes, 0); /* the message is on stderr */
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    (void)snprintf(ball_path, sizeof ball_path, "/tmp/voxrt_view_%ld.vox", (long)getpid());
    save_ball(ball_path);
    RUN(flies);
    RUN(follows_the_window);
    RUN(ends);
    (void)remove(ball_path);
    return test_end();
}
