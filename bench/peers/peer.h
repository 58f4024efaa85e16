/* peer.h - two systems at the same work in turn, one line of JSON for each - C++17 - MIT OR Unlicense, see LICENSE

   A program compares case after case:

       peer_side s[2] = {peer_ours("voxrt", "voxrt_trace"), peer_theirs("Embree 3.13.5", "intersect16")};
       s[0].run = [&] { ... };                       // work on g_peer_threads threads
       peer_time(s, 2, 5);                           // A B A B ...
       s[0].error = ...;                             // against what both are measured by
       peer_lines("V1", "blob 512", "rays_per_second", "1/s", rays, "rays", s, 2);

   The first side is ours. Lines are those of the other benchmarks and have beside it "side", "peer", "method", "spread"
   (most less least over the median), "bytes_each" and, on those of the others, "times": how many times better ours is,
   the median over the rounds, with the least and the most. One thread: seconds of the processor; more: of the clock.
   Include it after bench.h. */
#ifndef PEER_H_INCLUDED
#define PEER_H_INCLUDED
#include <algorithm>
#include <atomic>
#include <functional>
#include <malloc.h>
#include <string>
#include <thread>
#include <vector>

/* A program uses some of what is in the headers that the benchmarks share, which are C and begin tables with {0}. */
#if defined(__GNUC__)
#  pragma GCC diagnostic ignored "-Wunused-function"
#  pragma GCC diagnostic ignored "-Wunused-variable"
#  pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#endif

static int g_peer_threads = 1;

struct peer_side {
    const char *peer = nullptr;      /* NULL: ours */
    std::string method, isa = "native";
    std::function<void()> run;
    double bytes = NAN, bytes_each = NAN, error = NAN;
    double holes = NAN;              /* of a picture, % of its pixels */
    uint64_t hash = 0;               /* 0: not told */
    std::vector<double> seconds;     /* out, of each round */
    double value = NAN;              /* given instead of seconds: what is not a time */
};

BENCH_FN peer_side peer_ours(const char *method, const char *isa) {
    peer_side s;
    s.method = method;
    s.isa = isa;
    return s;
}

BENCH_FN peer_side peer_theirs(const char *peer, const char *method) {
    peer_side s;
    s.peer = peer;
    s.method = method;
    return s;
}

/* One thread: processor time; what other threads of the process spend counts, too. */
BENCH_FN double peer_once(const std::function<void()> &run) {
    const double start = g_peer_threads > 1 ? bench_wall() : bench_cpu();
    run();
    return (g_peer_threads > 1 ? bench_wall() : bench_cpu()) - start;
}

/* warm: whether each runs once before. Sides without a run have their seconds or value already. */
BENCH_FN void peer_time(peer_side *s, int count, int rounds, bool warm = true) {
    for (int i = 0; i < count && warm; i++) if (s[i].run) s[i].run();
    for (int k = 0; k < rounds; k++)
        for (int i = 0; i < count; i++) if (s[i].run) s[i].seconds.push_back(peer_once(s[i].run));
}

BENCH_FN double peer_median(std::vector<double> v) {
    if (v.empty()) return NAN;
    std::sort(v.begin(), v.end());
    return v.size() % 2 ? v[v.size() / 2] : 0.5 * (v[v.size() / 2 - 1] + v[v.size() / 2]);
}

/* work 0: the value is the time itself, in seconds; else it is the rate. */
BENCH_FN void peer_lines(const char *id, const char *kase, const char *metric, const char *unit, double work,
                         const char *error_unit, const peer_side *s, int count) {
    char bench[64];
    snprintf(bench, sizeof bench, "peers.%s", id);
    for (int i = 0; i < count; i++) {
        const peer_side &p = s[i];
        const double median = peer_median(p.seconds), value = p.seconds.empty() ? p.value : work > 0 ? work / median : median;
        bench_line(bench, kase, metric, value, unit);
        bench_num("error", p.error);
        bench_text("error_unit", error_unit);
        if (p.holes - p.holes == 0) bench_num("holes", p.holes);
        bench_num("threads", g_peer_threads);
        bench_text("isa", p.isa.c_str());
        bench_num("bytes", p.bytes);
        bench_num("bytes_each", p.bytes_each);
        bench_text("side", p.peer == nullptr ? "ours" : "theirs");
        if (p.peer != nullptr) bench_text("peer", p.peer);
        bench_text("method", p.method.c_str());
        bench_num("rounds", (double)p.seconds.size());
        if (!p.seconds.empty()) {
            const double least = *std::min_element(p.seconds.begin(), p.seconds.end());
            const double most = *std::max_element(p.seconds.begin(), p.seconds.end());
            bench_num("best", work > 0 ? work / least : least);
            bench_num("spread", (most - least) / median);
        }
        if (p.peer != nullptr) {
            std::vector<double> times;
            for (size_t k = 0; k < std::min(p.seconds.size(), s[0].seconds.size()); k++) times.push_back(p.seconds[k] / s[0].seconds[k]);
            if (times.empty() && s[0].value > 0 && strcmp(unit, "dB") != 0) times.push_back(p.value / s[0].value); /* sizes: less is better */
            if (!times.empty()) {
                bench_num("times", peer_median(times));
                bench_num("times_least", *std::min_element(times.begin(), times.end()));
                bench_num("times_most", *std::max_element(times.begin(), times.end()));
            }
        }
        if (p.hash != 0) bench_hash(p.hash);
        bench_end();
    }
}

/* fn(first, end) for parts of [0, count) on g_peer_threads threads, the caller among them. */
template <class F> static void peer_for(size_t count, size_t part, const F &fn) {
    std::atomic<size_t> next(0);
    auto work = [&] {
        for (;;) {
            const size_t first = next.fetch_add(part);
            if (first >= count) return;
            fn(first, std::min(count, first + part));
        }
    };
    std::vector<std::thread> others;
    for (int i = 1; i < g_peer_threads; i++) others.emplace_back(work);
    work();
    for (std::thread &t : others) t.join();
}

/* What the process has allocated and not freed, bytes. */
BENCH_FN double peer_heap(void) {
#if defined(__GLIBC__)
    const struct mallinfo2 m = mallinfo2();
    return (double)m.uordblks + (double)m.hblkhd;
#else
    return NAN;
#endif
}

/* The first lines of a program: the machine, and which of our headers is measured. version: major * 10^6 + minor * 10^3 + patch. */
BENCH_FN void peer_machine(const char *name, const char *argv0, const char *header, uint32_t version) {
    char text[64];
    bench_machine((std::string("peers_") + name).c_str(), argv0);
    snprintf(text, sizeof text, "%s %u.%u.%u", header, version / 1000000, version / 1000 % 1000, version % 1000);
    printf("{\"program_of\":\"%s\"", name);
    bench_text("header", text);
    bench_end();
}

/* As bench_parse; sizes are made with as many threads as there are, the work is timed with --threads of them. */
BENCH_FN int peer_parse(int argc, char **argv, bench_options *o) {
    const int status = bench_parse(argc, argv, o);
    if (status) return status;
    g_peer_threads = 1;
    for (int i = 1; i + 1 < argc; i++) if (strcmp(argv[i], "--threads") == 0) g_peer_threads = o->threads;
    o->threads = (int)sysconf(_SC_NPROCESSORS_ONLN);
    return 0;
}

#endif
