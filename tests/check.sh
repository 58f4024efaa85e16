#!/bin/bash
# Everything that `make check` checks.
#   bash tests/check.sh [group...]     groups: see GROUPS_ALL; without one all of them run
#   V=1                                names and times of the checks that passed, too
#   SHORT=1                            what fits the time of every change. Left out: standards between the oldest and the newest,
#                                      pairs of options, -O3 but for roundings, the six longest tests at full length, 10^8
#                                      points, -flto of two headers, clang's analyzer; fuzzers get 5 s each, always the same
#   JOBS=2 FUZZ_SECONDS=60 FUZZ_EACH= FUZZ_FIXED= SOAK_SECONDS=60 OUT=build/check
# Works on those of the three headers that exist. Each check is one line in the sum `N passed, N failed, N skipped`;
# all names, results and seconds are in $OUT/results. A check that cannot run here (no tool) is skipped.
cd "$(dirname "$0")/.." || exit 1
export LC_ALL=C
unset MAKEFLAGS MFLAGS MAKELEVEL MAKEOVERRIDES # each make that is started here has its own arguments

# --- what may be edited ------------------------------------------------------------------------------------------

GROUPS_ALL="text options matrix targets link symbols hygiene programs readme install long modes sanitize fuzz soak emulate windows wasm analyze"
SHORT=${SHORT:-}
JOBS=${JOBS:-$(nproc)}
OUT=$(realpath -m --relative-to=. "${OUT:-build/check}")
FUZZ_SECONDS=${FUZZ_SECONDS:-60}
FUZZ_FIXED=${FUZZ_FIXED:-}
FUZZ_EACH=${FUZZ_EACH:-}           # seconds for each target instead of FUZZ_SECONDS for all
LONG_BY_HAND="test_voxrt_gi test_tetcast_rbf test_voxrt_memory test_voxrt_paging test_voxrt_light test_tetcast_bricks" # not in SHORT
FUZZ_FORMATS="vox volume image mesh coded gi_scene bricks paged" # fuzzers of files
SOAK_SECONDS=${SOAK_SECONDS:-60}

STD_C="c99 c11 c17 gnu17"
STD_CXX="c++11 c++14 c++17 c++20"
if [ -n "$SHORT" ]; then STD_C="c99 gnu17" STD_CXX="c++11 c++20"; fi
WARN="-Wall -Wextra -Wpedantic -Werror -Wshadow -Wconversion -Wsign-conversion -Wdouble-promotion -Wfloat-conversion
 -Wcast-qual -Wcast-align -Wundef -Wvla -Wformat=2 -Wnull-dereference"
WARN_C="$WARN -Wstrict-prototypes -Wmissing-prototypes -Wold-style-definition"

# Undefined symbols that an object file of a header may have.
ALLOW_LIBC="malloc free calloc memcpy memset memmove memcmp memchr strlen strcmp strncmp sysconf getenv"
ALLOW_FORMAT="snprintf vsnprintf"
ALLOW_STDIO="fopen fread fwrite fclose fseek ftell fseeko ftello fflush ferror feof rename remove"
ALLOW_LIBM="sqrt sqrtf"            # gcc calls them for negative arguments only (errno); all else is our own code
ALLOW_LIBM_tetcast="fmaf"          # correctly rounded by definition; an instruction where there is one
ALLOW_THREADS="pthread_create pthread_join pthread_attr_init pthread_attr_setstacksize pthread_attr_destroy
 pthread_mutex_init pthread_mutex_lock pthread_mutex_unlock pthread_mutex_destroy
 pthread_cond_init pthread_cond_wait pthread_cond_signal pthread_cond_broadcast pthread_cond_destroy sched_yield"
ALLOW_COMPILER="bcmp __assert_fail __stack_chk_fail _GLOBAL_OFFSET_TABLE_ __cpu_model __cpu_indicator_init __errno_location" # bcmp: clang's memcmp(...) == 0
STACK_LIMIT=16384                  # bytes in one function
LINE_LIMIT=120                     # characters in a line of a header
PROGRAM_LINE_LIMIT=160             # and of a program

# Syntax checks for other machines: name, clang target, further flags (@P@ is the prefix); headers: stubs, and
# stubs/posix unless the third column says `bare`.
TARGETS="
aarch64        aarch64-linux-gnu           posix
armv7          armv7-linux-gnueabihf       posix
riscv64        riscv64-linux-gnu           posix
s390x          s390x-linux-gnu             posix
powerpc        powerpc-linux-gnu           posix
wasm32         wasm32-unknown-unknown      bare
wasm32-simd    wasm32-unknown-unknown      bare   -msimd128
i686           i686-linux-gnu              posix
mingw32        x86_64-w64-mingw32          posix
msvc-x64       x86_64-pc-windows-msvc      bare   -D@P@_NO_THREADS
msvc-arm64     aarch64-pc-windows-msvc     bare   -D@P@_NO_THREADS
"

# -idirafter: <asm/errno.h>, which is the same for 32 bits and only has its own place with gcc-multilib.
# The quick tests are built and run once more in each of these ways: name, compiler, flags (@P@: for each prefix).
MODES="
clang-O2       clang   -std=c99 -O2 -ffp-contract=off
gcc-native     gcc     -std=gnu17 -O3 -march=native
no-simd-thread gcc     -std=c99 -O1 -ffp-contract=off -D@P@_NO_SIMD -D@P@_NO_THREADS
m32            gcc     -std=c99 -O2 -ffp-contract=off -m32 -msse2 -mfpmath=sse -idirafter /usr/include/x86_64-linux-gnu
"
# gcc takes three quarters of the time for places of variables and for optimizing.
SANITIZERS="
asan-ubsan     gcc     -fsanitize=address,undefined -fno-sanitize-recover=all -Og -g1 -fno-var-tracking
tsan           clang   -fsanitize=thread
msan           clang   -fsanitize=memory -fsanitize-memory-track-origins
"
SAN_FLAGS="-std=c99 -g -O1 -ffp-contract=off -fno-omit-frame-pointer"
STATIC="-DVOXRT_STATIC -DZBUFRAND_STATIC -DTETCAST_STATIC" # what a program does not use is not compiled
# gcc for s390x computes float in double with -std=c99, which gives other bits.
EMULATE="
aarch64        aarch64-linux-gnu-gcc  qemu-aarch64
s390x          s390x-linux-gnu-gcc    qemu-s390x    -fexcess-precision=fast
"
# Windows: cross compiled and run by Wine. The stack is for an oracle in the tests, as is node's below; the libraries need 64 KB.
WINDOWS="
mingw-w64      x86_64-w64-mingw32-gcc  -static -Wl,--stack,8388608
"
# WebAssembly: compiled by Emscripten and run by node: what a browser without SIMD and threads has, and with both.
WASM="
wasm32
wasm32-full    -msimd128 -pthread -s PROXY_TO_PTHREAD=1
"
WASM_FLAGS="-s ALLOW_MEMORY_GROWTH=1 -s INITIAL_MEMORY=256MB -s MAXIMUM_MEMORY=4GB -s NODERAWFS=1 -s EXIT_RUNTIME=1"
NODE="node --no-experimental-fetch --stack-size=7000" # fetch: Emscripten of 2022 takes a node with it for a browser
# Tests that some of these ways leave out because of time, as shell patterns of group-name:test without test_, for
# example "emulate-*:voxrt_light sanitize-msan:zbufrand_*".
# No way leaves out test_golden.c, which compares results of all three libraries with hashes. Besides it:
#   modes and emulators   of zbufrand.h its pictures alone, which every part of it has to do with;
#                         of tetcast.h nothing, but no-simd-thread its optics, tables and transfer functions, s390x its
#                         cells, foams, integrals, projection, surfaces, transfer functions and walks
#   emulators             palettes take minutes there and have no bytes that an order could turn around; of trees and
#                         voxelising each has one
#   tsan, msan            of zbufrand.h its pictures, no other test of tetcast.h; asan-ubsan has all tests
#   Windows, WebAssembly  of zbufrand.h its pictures, of voxrt.h and tetcast.h about half
# SKIP_TESTS="*:view" bash tests/check.sh windows wasm runs them all.
SKIP_TESTS=${SKIP_TESTS-"[em]*:zbufrand_[!r]* [em]*:zbufrand_r[!e]* [em]*:zbufrand_rec*
 sanitize-[tm]*:zbufrand_[!r]* sanitize-[tm]*:zbufrand_r[!e]* sanitize-[tm]*:zbufrand_rec* sanitize-tsan:tetcast_* sanitize-msan:tetcast_*
 modes-[!n]*:tetcast_* modes-n*:tetcast_[!ot]* emulate-a*:tetcast_* emulate-s*:tetcast_[bmors]* emulate-s*:tetcast_ta* emulate-*:view
 emulate-aarch64:support emulate-*:voxrt_palette emulate-aarch64:voxrt_tree emulate-s390x:voxrt_voxelize
 w*:view w*:zbufrand_[!r]* w*:zbufrand_r[!e]* w*:zbufrand_rec* w*:voxrt_[glp]* w*:tetcast_[bcmps]* w*:tetcast_rbf
 wasm-wasm32-*:s* wasm-wasm32-*:vol* wasm-wasm32-*:voxrt_[!rt]* wasm-wasm32-*:voxrt_trace wasm-wasm32-*:tetcast_[!r]*"}
ITEM_TIMEOUT=${ITEM_TIMEOUT:-600}  # seconds of processor time for one test program in the slow ways

# --- machinery ---------------------------------------------------------------------------------------------------

HEADERS=(); for n in voxrt zbufrand tetcast; do [ -f $n.h ] && HEADERS+=($n); done
mkdir -p "$OUT/log" "$OUT/tu" "$OUT/obj"; : > "$OUT/results"
ROOT=$PWD
running=0

upper() { echo "$1" | tr a-z A-Z; }
have() { command -v "$1" >/dev/null 2>&1; }
cmd() { echo "\$ $*"; "$@"; }
skip() { echo "$*"; return 77; }

# run_item NAME COMMAND...: the command's status is the result, 77 means skipped and the last line says why
run_item() {
    local name=$1 log rc t0=$SECONDS text; shift
    log=$OUT/log/${name//[^A-Za-z0-9.+-]/_}
    ( "$@" ) > "$log" 2>&1 < /dev/null; rc=$?
    case $rc in
    0) text="ok    $name"; echo "ok $((SECONDS - t0)) $name" >> "$OUT/results"; [ -n "$V" ] && echo "$text ($((SECONDS - t0)) s)" ;;
    77) echo "skip $((SECONDS - t0)) $name" >> "$OUT/results"; echo "skip  $name: $(tail -n 1 "$log")" ;;
    *) echo "FAIL $((SECONDS - t0)) $name" >> "$OUT/results"
       printf '%s\n' "FAIL  $name (status $rc, all of it in $log)
$( (if [ "$(wc -l < "$log")" -le 60 ]; then cat "$log"; else head -n 25 "$log"; echo ...; tail -n 35 "$log"; fi) |
           cut -c 1-400 | sed 's/^/      /')" ;;
    esac
}
item() { # in the background, $JOBS at a time
    if [ $running -ge "$JOBS" ]; then wait -n; running=$((running - 1)); fi
    run_item "$@" & running=$((running + 1))
}
barrier() { wait; running=0; }
solo() { barrier; run_item "$@"; }

matches() { # NAME PATTERNS
    local p; set -f; for p in $2; do case $1 in $p) set +f; return 0 ;; esac; done; set +f; return 1
}
fill() { # TEXT with @P@: each word that has it once for each header
    local w n; for w in $1; do
        case $w in *@P@*) for n in "${HEADERS[@]}"; do echo "${w//@P@/$(upper $n)}"; done ;; *) echo "$w" ;; esac
    done
}
option_macros() { # NAME: the X_NO_* macros that the header asks for
    grep -E '^ *# *(if|elif|ifdef|ifndef)' $1.h | grep -oE "\b$(upper $1)_NO_[A-Z0-9_]+" | sort -u
}
api_functions() { # NAME: functions declared before the implementation
    sed "/defined($(upper $1)_IMPLEMENTATION)/q" $1.h | grep -E "^($(upper $1)_EXPERIMENTAL )?$(upper $1)_DEF " | grep -oE "\b$1_[a-z0-9_]+\(" | tr -d '(' | sort -u
}
make_units() { # source files that each compile check shares
    local n P f
    for n in "${HEADERS[@]}"; do
        P=$(upper $n); mkdir -p "$OUT/tu/$n"
        printf '#include "%s.h"\n#include "%s.h"\n#define %s_IMPLEMENTATION\n#include "%s.h"\n#include "%s.h"\n' \
            $n $n $P $n $n > "$OUT/tu/$n/impl.c"
        printf '#include "%s.h"\n#include "%s.h"\n' $n $n > "$OUT/tu/$n/decl.c"
        { printf '#include "%s.h"\n#include <stdio.h>\ntypedef void (*any_fn)(void);\nstatic const any_fn all[] = {\n' $n
          for f in $(api_functions $n); do echo "    (any_fn)$f,"; done
          printf '    (any_fn)0\n};\nint main(void) {\n    size_t i = 0;\n    while (all[i]) i++;\n'
          printf '    printf("%%d functions\\n", (int)i);\n    return i + 1 != sizeof all / sizeof all[0];\n}\n'; } > "$OUT/tu/$n/use.c"
        { cat tests/compile/poison.h; cat "$OUT/tu/$n/impl.c"; } > "$OUT/tu/$n/poison.c"
        { echo '#include <complex.h>'; cat "$OUT/tu/$n/impl.c"; } > "$OUT/tu/$n/complex.c"
        { echo "#define ${P}_STATIC"; cat "$OUT/tu/$n/impl.c"; printf 'int static_one(void);\nint static_one(void) { return 1; }\n'; } > "$OUT/tu/$n/static1.c"
        { echo "#define ${P}_STATIC"; cat "$OUT/tu/$n/impl.c"; printf 'int static_one(void);\nint main(void) { return static_one() - 1; }\n'; } > "$OUT/tu/$n/static2.c"
        { printf '#include <stddef.h>\nvoid *my_malloc(size_t size, void *user);\nvoid my_free(void *ptr, size_t size, void *user);\n'
          printf '#define %s_MALLOC(size, user) my_malloc(size, user)\n#define %s_FREE(ptr, size, user) my_free(ptr, size, user)\n' $P $P
          printf '#define %s_ASSERT(cond) ((void)(cond))\n' $P
          cat "$OUT/tu/$n/impl.c"; } > "$OUT/tu/$n/custom.c"
    done
    : > "$OUT/tu/all.c"; : > "$OUT/tu/all_reverse.c"
    for n in "${HEADERS[@]}"; do printf '#define %s_IMPLEMENTATION\n#include "%s.h"\n' "$(upper $n)" $n >> "$OUT/tu/all.c"; done
    for n in $(printf '%s\n' "${HEADERS[@]}" | tac); do printf '#include "%s.h"\n' $n >> "$OUT/tu/all_reverse.c"; done
    for n in $(printf '%s\n' "${HEADERS[@]}" | tac); do printf '#define %s_IMPLEMENTATION\n#include "%s.h"\n' "$(upper $n)" $n >> "$OUT/tu/all_reverse.c"; done
}
c() { local cc=$1; shift; have "$cc" || skip "no $cc" || return; cmd "$cc" $WARN_C -I"$ROOT" "$@"; }
cxx() { local cc=$1; shift; have "$cc" || skip "no $cc" || return; cmd "$cc" $WARN -I"$ROOT" "$@"; }

# --- text: characters, lines, tags, banned words -----------------------------------------------------------------

text_plain() { # LINE-LIMIT FILE...
    local f bad=0 limit=$1; shift
    for f; do
        if grep -nP '[^\x0a\x20-\x7e]' "$f" | head -n 5 | grep . ; then echo "$f: only printable ASCII and LF, no tabs"; bad=1; fi
        if awk -v n=$limit 'length > n { if (b++ < 5) print FILENAME ":" FNR ": " length " characters" } END { exit !b }' "$f"; then bad=1; fi
        if grep -n ' $' "$f" | head -n 5 | grep .; then echo "$f: blanks at the end of a line"; bad=1; fi
        [ -z "$(tail -c 1 "$f")" ] || { echo "$f: no newline at the end"; bad=1; }
    done
    return $bad
}
text_tags() { # NAME: @tag of the contents list and // >>tag of the sections
    local n=$1
    awk '/^#/ { exit } { print }' $n.h | grep -oE '(^|[ *])@[a-z][a-z0-9_]*' | grep -oE '[a-z][a-z0-9_]*' | sort > "$OUT/tu/$n/tags_contents"
    grep -oE '// >>[a-z][a-z0-9_]*' $n.h | grep -oE '[a-z][a-z0-9_]*' | sort > "$OUT/tu/$n/tags_sections"
    [ -s "$OUT/tu/$n/tags_contents" ] || { echo "$n.h: the first comment has no @tag"; return 1; }
    diff -u "$OUT/tu/$n/tags_contents" "$OUT/tu/$n/tags_sections"
}
common_part() { # NAME: from // >>platform to the section after math, without the prefix
    awk '/\/\/ >>platform/ { on = 1 } /\/\/ >>/ && seen { exit } /\/\/ >>math/ { seen = on } on { print }' $1.h |
      awk '{ line[NR] = $0 } END { n = NR; while (n > 0 && line[n] ~ /^ *(\/\/|\/\*|\*|$)/) n--; for (i = 1; i <= n; i++) print line[i] }' |
      sed -e "s/$1/xyz/g" -e "s/$(upper $1)/XYZ/g"
}
text_common() { # NAME OTHER
    common_part $1 > "$OUT/tu/common_$1"; common_part $2 > "$OUT/tu/common_$2"
    [ -s "$OUT/tu/common_$1" ] || { echo "$1.h has no section >>platform"; return 1; }
    diff -u "$OUT/tu/common_$1" "$OUT/tu/common_$2"
}
text_banned() { # NAME
    local bad=0 what why
    while IFS='~' read -r what why; do # a pattern, and why it is banned
        [ -n "$what" ] || continue
        # fused operations that are written down, and only those, are part of what the walkers compute
        [ "$1" = tetcast ] && case $what in *fma*) continue ;; esac
        if grep -nE -- "$what" $1.h | grep -vE '^[0-9]+: *(/\*|//|\*)' | head -n 5 | grep .; then echo "^ $why"; bad=1; fi
    done <<'LIST'
pragma +(GCC|clang) +diagnostic~no warning is silenced
pragma +warning~no warning is silenced
_mm[0-9]*_(mask_|maskz_)?r(cp|sqrt)(14|28)?_~approximate instructions differ between processors
target\("[^"]*fma~a fused multiply-add changes results
\b(strcpy|strcat|sprintf|gets|alloca|setjmp|longjmp|abort|exit) *\(~not in a library
__[a-z]+__ *\(\(constructor~not in a library
\bgoto +\*~not C99
LIST
    return $bad
}
text_version() { # NAME: line 1, licence, version
    local P; P=$(upper $1)
    local v; v=$(for k in MAJOR MINOR PATCH; do sed -n "s/^# *define  *${P}_VERSION_$k  *\([0-9]*\).*/\1/p" $1.h; done | tr '\n' '.' | sed 's/\.$//')
    head -n 1 $1.h | grep -qF "$1.h - v$v - " || { echo "line 1 is not '/* $1.h - v$v - ...'"; return 1; }
    head -n 2 $1.h | grep -q 'SPDX-License-Identifier: MIT OR Unlicense' || { echo "no SPDX-License-Identifier in lines 1-2"; return 1; }
    tail -n 80 $1.h | grep -q 'WITHOUT WARRANTY' || { echo "no licence text at the end"; return 1; }
    grep -q "^## .*$v\|$1.*$v" CHANGELOG.md || { echo "CHANGELOG.md does not know version $v"; return 1; }
}
text_functions() { # FILES: each under 100 lines, from the line of its name to its brace
    awk 'FNR == 1 { first = open = 0 }
        /^[a-zA-Z][^;=]*[(]/ && !open { first = FNR }
        /[{]$/ && first { open = 1 }
        /^}/ { if (open && FNR - first >= 99) { print FILENAME ":" first ": a function of " FNR - first + 1 " lines"; bad = 1 } first = open = 0 }
        END { exit bad }' "$@"
}
group_text() {
    local n other=() files
    for n in "${HEADERS[@]}"; do
        item "text $n plain" text_plain $LINE_LIMIT $n.h
        item "text $n tags" text_tags $n
        item "text $n banned" text_banned $n
        item "text $n version" text_version $n
        [ ${#other[@]} -gt 0 ] && item "text $n common sections equal ${other[0]}" text_common ${other[0]} $n
        other+=($n)
    done
    mapfile -t files < <(find examples tests bench \( -name '*.[ch]' -o -name '*.cpp' \) ! -path '*/corpus/*' | sort)
    item "text programs plain" text_plain $PROGRAM_LINE_LIMIT "${files[@]}"
    item "text functions under 100 lines" text_functions "${HEADERS[@]/%/.h}" "${files[@]}"
}

# --- options: every X_NO_* is documented and known; wrong combinations are refused -------------------------------

options_listed() { # NAME
    local m bad=0
    for m in $(option_macros $1); do
        awk '/^#/ { exit } { print }' $1.h | grep -qw "$m" || { echo "$m is not in the comment at the top of $1.h"; bad=1; }
    done
    for m in $(awk '/^#/ { exit } { print }' $1.h | grep -oE "\b$(upper $1)_NO_[A-Z0-9_]+" | sort -u); do
        grep -qE "^ *# *define +$m +[^ ]" $1.h && continue # a constant, not an option
        option_macros $1 | grep -qx "$m" || { echo "$m is documented and does nothing"; bad=1; }
    done
    return $bad
}
refuses() { # FLAGS...: compiling must fail through #error
    local out
    if out=$(gcc -std=c99 -I"$ROOT" -fsyntax-only "$@" 2>&1); then echo "gcc $*: compiled, #error was expected"; return 1; fi
    echo "$out" | grep '#error'
}
group_options() {
    local n P
    for n in "${HEADERS[@]}"; do
        P=$(upper $n)
        item "options $n documented" options_listed $n
        item "options $n refuses MALLOC alone" refuses "-D${P}_MALLOC(s,u)=0" "$OUT/tu/$n/impl.c"
        item "options $n refuses -ffast-math" refuses -ffast-math "$OUT/tu/$n/impl.c"
        item "options $n accepts ALLOW_FAST_MATH" gcc -std=c99 -I"$ROOT" -fsyntax-only -ffast-math -D${P}_ALLOW_FAST_MATH "$OUT/tu/$n/impl.c"
    done
}

# --- matrix: compilers, standards, options; zero warnings --------------------------------------------------------
# SHORT leaves out of this the standards between the first and the last, pairs of options, each option with clang and with C++,
# -march=native and -O3.

m32() { # COMPILER FLAGS...
    echo '#include <stdlib.h>
int main(void) { return 0; }' > "$OUT/tu/m32.$BASHPID.c"
    $1 -m32 -c -o /dev/null "$OUT/tu/m32.$BASHPID.c" 2>/dev/null || skip "$1 -m32 finds no 32-bit headers" || return
    c "$@"
}
group_matrix() {
    local n P t cc s m k opts o3; local -a macros
    for n in "${HEADERS[@]}"; do
        P=$(upper $n); t=$OUT/tu/$n; mapfile -t macros < <(option_macros $n)
        for cc in gcc clang; do
            # gcc finds more when it optimizes, clang the same, but for what only code generation refuses
            [ $cc = gcc ] && o3=-O3 || o3=-O0
            for s in $STD_C; do
                if [ $s = c99 ]; then item "matrix $n $cc $s" c $cc -std=$s -O0 -c -o /dev/null "$t/impl.c"
                else item "matrix $n $cc $s" c $cc -std=$s -fsyntax-only "$t/impl.c"; fi
                [ -n "$SHORT" ] && [ $s != c99 ] ||
                    item "matrix $n $cc $s STATIC" c $cc -std=$s -fsyntax-only -D${P}_STATIC "$t/impl.c"
                item "matrix $n $cc $s declarations" c $cc -std=$s -fsyntax-only "$t/decl.c"
            done
            item "matrix $n $cc poison" c $cc -std=c99 -fsyntax-only "$t/poison.c"
            item "matrix $n $cc complex.h" c $cc -std=c99 -fsyntax-only "$t/complex.c"
            item "matrix $n $cc own allocator" c $cc -std=c99 -O0 -c -o /dev/null "$t/custom.c"
            if [ -n "$SHORT" ]; then item "matrix $n $cc NDEBUG" c $cc -std=gnu17 -fsyntax-only -DNDEBUG "$t/impl.c"
            else item "matrix $n $cc NDEBUG $o3 -march=native" c $cc -std=gnu17 $o3 -march=native -DNDEBUG -c -o /dev/null "$t/impl.c"; fi
            item "matrix $n $cc -m32" m32 $cc -m32 -std=c99 -O0 -c -o /dev/null "$t/impl.c"
            for m in "${macros[@]}"; do
                [ -n "$SHORT" ] || item "matrix $n $cc $m" c $cc -std=c99 -O0 -D$m -c -o /dev/null "$t/impl.c"
                [ -n "$SHORT" ] && [ $cc != clang ] || # which says what is not used, and gcc only where it makes code
                    item "matrix $n $cc $m STATIC" c $cc -std=c99 -fsyntax-only -D$m -D${P}_STATIC "$t/impl.c"
            done
            [ ${#macros[@]} -gt 0 ] && item "matrix $n $cc every NO_ at once" c $cc -std=c99 -O0 "${macros[@]/#/-D}" -c -o /dev/null "$t/impl.c"
        done
        [ -n "$SHORT" ] || for ((m = 0; m < ${#macros[@]}; m++)); do for ((k = m + 1; k < ${#macros[@]}; k++)); do
            opts="${macros[m]} ${macros[k]}"
            item "matrix $n pair $opts" c gcc -std=c99 -fsyntax-only -D${macros[m]} -D${macros[k]} "$t/impl.c"
        done; done
        for cc in g++ clang++; do
            for s in $STD_CXX; do
                if [ $s = c++11 ]; then item "matrix $n $cc $s" cxx $cc -x c++ -std=$s -O0 -c -o /dev/null "$t/impl.c"
                else item "matrix $n $cc $s" cxx $cc -x c++ -std=$s -fsyntax-only "$t/impl.c"; fi
                [ -n "$SHORT" ] && [ $s != c++11 ] ||
                    item "matrix $n $cc $s STATIC" cxx $cc -x c++ -std=$s -fsyntax-only -D${P}_STATIC "$t/impl.c"
                item "matrix $n $cc $s declarations" cxx $cc -x c++ -std=$s -fsyntax-only "$t/decl.c"
            done
            item "matrix $n $cc poison" cxx $cc -x c++ -std=c++17 -fsyntax-only "$t/poison.c"
            [ -n "$SHORT" ] || for m in "${macros[@]}"; do
                item "matrix $n $cc $m" cxx $cc -x c++ -std=c++17 -fsyntax-only -D$m "$t/impl.c"
            done
        done
    done
    if [ ${#HEADERS[@]} -gt 1 ]; then
        for s in all all_reverse; do
            for cc in gcc clang; do item "matrix $s $cc" c $cc -std=c99 -fsyntax-only "$OUT/tu/$s.c"; done
            for cc in g++ clang++; do item "matrix $s $cc" cxx $cc -x c++ -std=c++17 -fsyntax-only "$OUT/tu/$s.c"; done
        done
    fi
}

# --- targets: syntax for other machines, without their toolchains ------------------------------------------------

target() { # NAME TARGET KIND FLAGS...
    local n=$1 t=$2 kind=$3 inc; shift 3
    have clang || skip "no clang" || return
    inc="-isystem $(clang -print-resource-dir)/include -isystem tests/compile/stubs"
    [ $kind = posix ] && inc="$inc -isystem tests/compile/stubs/posix"
    cmd clang --target=$t -nostdinc $inc $WARN_C -I. -std=c99 -fsyntax-only "$@" "$OUT/tu/$n/impl.c" &&
    cmd clang --target=$t -nostdinc $inc $WARN -I. -x c++ -std=c++11 -fsyntax-only "$@" "$OUT/tu/$n/impl.c"
}
group_targets() {
    local n name t kind flags
    for n in "${HEADERS[@]}"; do
        while read -r name t kind flags; do
            [ -n "$name" ] && item "targets $n $name" target $n $t $kind ${flags//@P@/$(upper $n)}
        done <<< "$TARGETS"
    done
}

# --- link: C and C++ together, two static copies -----------------------------------------------------------------

link_pair() { # NAME IMPL-COMPILER IMPL-FLAGS USE-COMPILER USE-FLAGS FLAGS
    local n=$1 d=$OUT/obj/link.$BASHPID; mkdir -p "$d"
    have $2 && have $4 || skip "no $2 or $4" || return
    cmd $2 $3 $6 -I. -c -o "$d/impl.o" "$OUT/tu/$n/impl.c" &&
    cmd $4 $5 $6 $WARN -I. -c -o "$d/use.o" "$OUT/tu/$n/use.c" &&
    cmd $7 $6 -o "$d/prog" "$d/use.o" "$d/impl.o" -lm -lpthread && "$d/prog"
    local rc=$?; rm -rf "$d"; return $rc
}
link_static() { # NAME COMPILER FLAGS
    local d=$OUT/obj/static.$BASHPID; mkdir -p "$d"
    cmd $2 $3 -O0 -I. -o "$d/prog" "$OUT/tu/$1/static1.c" "$OUT/tu/$1/static2.c" -lm -lpthread && "$d/prog"
    local rc=$?; rm -rf "$d"; return $rc
}
golden_cxx() { # COMPILER STANDARD: the results of all three libraries, compiled as C++
    local p=$OUT/obj/golden.$BASHPID
    cxx $1 -x c++ -std=$2 -O1 $STATIC -o "$p" tests/test_golden.c -lm -lpthread && "$p"
    local rc=$?; rm -f "$p"; return $rc
}
group_link() {
    local n
    for n in "${HEADERS[@]}"; do
        item "link $n C in C" link_pair $n gcc "-std=c99 -O0" gcc "-std=c99 -O0" "" gcc
        item "link $n C in C++" link_pair $n gcc "-std=c99 -O0" g++ "-x c++ -std=c++11 -O0" "" g++
        item "link $n C++ in C" link_pair $n g++ "-x c++ -std=c++17 -O0" gcc "-std=c99 -O0" "" g++
        [ -n "$SHORT" ] && [ $n != zbufrand ] || item "link $n C in C++ -flto" link_pair $n gcc "-std=c99 -O1" g++ "-x c++ -std=c++17 -O1" -flto g++
        item "link $n two STATIC gcc" link_static $n gcc -std=c99
        item "link $n two STATIC clang++" link_static $n clang++ "-x c++ -std=c++17"
    done
    item "link golden results g++ c++20" golden_cxx g++ c++20
    [ -n "$SHORT" ] || item "link golden results clang++ c++17" golden_cxx clang++ c++17
}

# --- symbols: what an object exports and needs; mutable data; stack ----------------------------------------------

symbols() { # NAME exported|static "ALLOWED" COMPILER FLAGS...
    local n=$1 kind=$2 allowed=$3 cc=$4 bad=0 o=$OUT/obj/sym.$BASHPID s dumps=; shift 4
    have $cc || skip "no $cc" || return
    [ "$cc $*" = "gcc -std=c99 -O2" ] && dumps=$(slp_dumps "$o")
    cmd $cc $WARN_C -I. -fno-pic -fno-pie -fstack-usage $dumps "$@" -c -o "$o.o" "$OUT/tu/$n/impl.c" || return 1
    [ -z "$dumps" ] || roundings_kept "$o" || bad=1
    s=$(nm "$o.o" | awk '$(NF-1) ~ /^[A-TV-Z]$/ { print $NF }' | if [ $kind = static ]; then cat; else grep -v "^$n\_"; fi)
    [ -z "$s" ] || { echo "exported:" $s; bad=1; }
    [ $kind = static ] || nm "$o.o" | grep -q " T $n\_" || { echo "exports nothing"; bad=1; }
    s=$(nm "$o.o" | awk '$(NF-1) ~ /^[DdBbCcGgSs]$/ { print $NF }')
    [ -z "$s" ] || { echo "mutable static data:" $s; bad=1; }
    s=$(nm -u "$o.o" | awk '{ print $NF }' | sed 's/@.*//' | sort -u | grep -vxF "$(printf '%s\n' $allowed $ALLOW_COMPILER)")
    [ -z "$s" ] || { echo "needs symbols that are not allowed:" $s; bad=1; }
    if [ -f "$o.su" ]; then
        awk -v limit=$STACK_LIMIT '$2 > limit || $3 ~ /^dynamic$/ { print "stack: " $0; bad = 1 } END { exit !bad }' "$o.su" && bad=1
        sort -k2,2nr "$o.su" | head -n 3 | sed 's/^/most stack: /'
    fi
    rm -f "$o.o" "$o.su"; return $bad
}
# gcc 12 takes (double)(float)x for x where it turns two of them side by side into vectors: no place where that could be.
slp_dumps() { echo "-fdump-tree-slp1=$1.1 -fdump-tree-slp2=$1.2 -fdump-tree-vect=$1.3"; }
roundings_kept() { # DUMPS: removes them
    local rc=0
    cat "$1".[123] | awk '/^;; Function/ { name = $3; delete short }
        $2 == "=" && /= \(vector\([0-9]+\) float\) / { short[$1] = 1 }
        $2 == "=" && /= \(vector\([0-9]+\) double\) / { from = $5; sub(/;$/, "", from); if (from in short) { print "a rounding is lost in " name ": " $0; bad = 1 } }
        END { exit bad }' || rc=1
    rm -f "$1".[123]; return $rc
}
roundings_kept_O3() { # NAME FLAGS...: 256 bits make other pairs than 128
    local d=$OUT/tu/$1/slp.$BASHPID n=$1; shift
    cmd gcc -std=c99 -O3 "$@" $WARN_C -ffp-contract=off -I. $(slp_dumps "$d") -c -o /dev/null "$OUT/tu/$n/impl.c" && roundings_kept "$d"
}
group_symbols() {
    local n P libm all
    for n in "${HEADERS[@]}"; do
        P=$(upper $n); libm=ALLOW_LIBM_$n; libm="$ALLOW_LIBM ${!libm}"
        all="$ALLOW_LIBC $ALLOW_FORMAT $ALLOW_STDIO $libm $ALLOW_THREADS"
        item "symbols $n gcc -O2" symbols $n exported "$all" gcc -std=c99 -O2
        item "symbols $n gcc -O0" symbols $n exported "$all" gcc -std=c99 -O0
        [ -n "$SHORT" ] || item "symbols $n clang -O1" symbols $n exported "$all" clang -std=c99 -O1
        item "symbols $n STATIC" symbols $n static "$all" gcc -std=c99 -O0 -D${P}_STATIC
        item "symbols $n NO_STDIO" symbols $n exported "$ALLOW_LIBC $ALLOW_FORMAT $libm $ALLOW_THREADS" gcc -std=c99 -O0 -D${P}_NO_STDIO
        item "symbols $n NO_THREADS" symbols $n exported "$ALLOW_LIBC $ALLOW_FORMAT $ALLOW_STDIO $libm" gcc -std=c99 -O0 -D${P}_NO_THREADS
        [ -n "$SHORT" ] || item "symbols $n roundings to float are kept" roundings_kept_O3 $n
        [ "$(uname -m)" != x86_64 ] || item "symbols $n roundings to float are kept, AVX2" roundings_kept_O3 $n -march=haswell
        [ -n "$SHORT" ] || item "symbols $n NO_SIMD -O2" symbols $n exported "$all" gcc -std=c99 -O2 -D${P}_NO_SIMD
    done
}

# --- hygiene: macros that a program sees after including a header ------------------------------------------------

macros() { # NAME FILE
    local n=$1 P d=$OUT/tu/$1/macros.$BASHPID; P=$(upper $n)
    # everything the header may include, by itself, is not the header's fault
    grep -oE '^ *# *include *<[^>]*>' $n.h | sed 's/^ *# */#/' | grep -v 'avx2*intrin' | sort -u |
        awk -F'[<>]' '{ print "#if __has_include(<" $2 ">)\n" $0 "\n#endif" }' > "$d.c"
    gcc -std=c99 -I. -dM -E "$d.c" | awk '{ sub(/\(.*/, "", $2); print $2 }' | sort -u > "$d.base"
    gcc -std=c99 -I. -dM -E "$2" | awk '{ sub(/\(.*/, "", $2); print $2 }' | sort -u > "$d.have"
    local leak; leak=$(comm -13 "$d.base" "$d.have" | grep -vE "^(${P}|$n)I?i?_")
    rm -f "$d".*
    [ -z "$leak" ] || { echo "macros without the prefix:" $leak; return 1; }
}
declarations_light() { # NAME: the declaration part includes only these
    local bad; bad=$(gcc -std=c99 -I. -M "$OUT/tu/$1/decl.c" | tr ' \\' '\n\n' | grep -E '/(pthread|immintrin|emmintrin|windows|stdlib|string|stdio|math|unistd)\.h$')
    [ -z "$bad" ] || { echo "the declarations include:" $bad; return 1; }
}
group_hygiene() {
    local n
    for n in "${HEADERS[@]}"; do
        item "hygiene $n macros of the declarations" macros $n "$OUT/tu/$n/decl.c"
        item "hygiene $n macros of the implementation" macros $n "$OUT/tu/$n/impl.c"
        item "hygiene $n declarations include little" declarations_light $n
    done
}

# --- programs: examples, tests, benches under the same warnings; pictures ----------------------------------------

# Exit status: 0 done, 1 the input was bad (one line on stderr, nothing written), 2 wrong usage (one line on stderr).
EXITS="
0 voxrt_convert --help
0 voxrt_convert --scene sphere @/s.vox --res 32 --quiet
0 voxrt_render @/s.vox --out @/s.png --size 32x32 --quiet
0 voxrt_render @/s.vox --out @/s%d.png --size 32x32 --quiet --frames 3 --budget 5 --blend --cubes
0 voxrt_render @/s.vox --out @/many.png --size 32x32 --quiet --scatter 20 --shadows
0 voxrt_gi --scene cornell --save @/c.txt --export @/e.txt
0 voxrt_gi --scene @/e.txt --out @/e.png --size 32x32 --res 32 --grid 32 --voxels samples --quiet
0 voxrt_convert @/s.vox @/t.vox --share --raw
0 voxrt_convert --scene sphere @/planet.vox --res 32 --fill --edit examples/planet.txt --quiet --stats
1 voxrt_convert @/s.vox @/bad.vox --edit @/garbage.obj
1 voxrt_convert @/s.vox @/bad.vox --edit @/none.txt
0 voxrt_render @/t.vox --out @/t.png --size 32x16 --panorama --eye 9,9,9 --at 0,0,0 --specular 1
1 voxrt_convert @/none.ply @/bad.vox
1 voxrt_convert @/cut.vox @/bad.vox
1 voxrt_convert @/garbage.obj @/bad.vox
1 voxrt_render @/none.vox --out @/bad.png
1 voxrt_render @/garbage.obj --out @/bad.png
1 voxrt_render @/cut.vox --out @/bad.png
1 voxrt_render @/s.vox --out @/no/folder.png --size 8x8
1 voxrt_view @/garbage.obj
1 voxrt_view @/cut.vox
1 voxrt_gi --scene @/none.txt --out @/bad.png
1 voxrt_gi --scene @/garbage.obj --out @/bad.png
1 voxrt_gi --scene cornell --save @/no/folder.txt
1 zbufrand_render --scene @/garbage.obj --out @/bad.png
1 zbufrand_render --scene landscape --out @/bad.png --memory 1
0 zbufrand_render --scene landscape --out @/zl.png --size 64x48 --points 20000 --mode gauss --buckets 8 --mend --stats --quiet
0 zbufrand_render --scene landscape --out @/zl.png --size 64x48 --aa 2 --measure-costs --stats --quiet
0 zbufrand_render --scene landscape --out @/zf.png --size 64x48 --frames 9 --quiet
0 zbufrand_render --scene @/one.obj --out @/zo.png --size 64x48 --frames 3 --quiet
1 tetcast_render @/garbage.obj --out @/bad.png
1 tetcast_render @/nan.vtk --out @/bad.png
1 tetcast_render @/huge.vtk --out @/bad.png
1 tetcast_render @/cell.vtk --out @/bad.png --iso 7 --smooth
1 tetcast_render @/cell.vtk --out @/bad.png --mask t
1 tetcast_render @/cell.vtk --out @/bad.png --iso 7 --surface @/bad.obj
0 tetcast_render @/cell.vtk --out @/one_cell.png --mask s --colors independent --table 9 --size 16x16 --stats --check --quiet
0 tetcast_render --scene lattice --detail 4 --iso 0.5 --surface @/one.obj --out @/one_surface.png --size 16x16 --quiet
1 tetcast_bricks resample @/garbage.obj @/bad.brk
1 tetcast_bricks render @/garbage.brk --out @/bad.png
1 tetcast_rbf fit @/garbage.obj @/bad.rbf --max-error 0.1
1 tetcast_rbf render @/garbage.rbf --out @/bad.png
0 tetcast_rbf fit ball @/ball.rbf --detail 6 --max-error 0.3 --quiet
0 tetcast_rbf fit ball @/ball2.rbf --detail 6 --max-error 0.2 --start @/ball.rbf --quiet
1 tetcast_rbf fit ball @/bad.rbf --detail 6 --start @/garbage.rbf
1 tetcast_rbf fit ball @/bad.rbf --detail 6 --kernel power --start @/ball.rbf
0 tetcast_rbf render @/ball.rbf --inside ball --detail 6 --out @/ball.png --size 16x16 --quiet
1 tetcast_rbf render @/ball.rbf --inside @/garbage.obj --out @/bad.png
0 tetcast_rbf decode @/ball.rbf @/ball.brk --max-error 0.3 --longest-end 65 --quiet
1 tetcast_rbf decode @/garbage.rbf @/bad.brk
0 tetcast_bricks render @/ball.brk --out @/b.png --coded @/b.tile --codec alpha --size 16x16 --seconds 1 --quiet
0 tetcast_bricks tile @/b.tile --out @/b2.png
1 tetcast_bricks tile @/garbage.brk --out @/bad.png
0 tetcast_bricks slice --scene ball --detail 6 --out @/slice.png --section @/section.obj --size 16x16
0 tetcast_bricks slice @/ball.brk --normal 1,1,0 --out @/slice2.png --size 16x16
1 tetcast_bricks slice @/garbage.brk --out @/bad.png
2 tetcast_bricks slice --scene ball --out @/bad.png --normal 0,0,0
2 tetcast_bricks resample --scene ball @/bad.brk --average
2 tetcast_bricks resample --scene ball @/bad.brk --focus 0,0,0
2 tetcast_bricks resample --scene ball @/bad.brk --longest 9 --average --focus 0,0,0 --radius 1
2 tetcast_bricks render @/ball.brk --out @/bad.png --focus 0,0,0
2 voxrt_convert
2 voxrt_convert --scene nothing @/bad.vox
2 voxrt_convert @/garbage.obj @/bad.vox --detail 3
2 voxrt_convert @/garbage.obj @/bad.vox --res 0
2 voxrt_convert @/garbage.obj @/garbage.obj
2 voxrt_convert @/s.vox @/bad.vox --res 9
2 voxrt_convert --scene sphere @/bad.vox --share --format v4
2 voxrt_render
2 voxrt_render @/s.vox
2 voxrt_render @/s.vox --out @/bad.jpg
2 voxrt_render @/s.vox --out @/bad.png --smooth
2 voxrt_render @/s.vox --out @/bad.png --frames 2
2 voxrt_render @/s.vox --out @/bad.png --budget 5
2 voxrt_render @/s.vox --out @/bad.png --scatter 3 --path thesis
2 voxrt_render @/s.vox --out @/bad.png --heat outer --split
2 voxrt_render @/s.vox --out @/bad.png --heat-max 9
2 voxrt_render @/s.vox --out @/bad.png --panorama
2 voxrt_render @/s.vox --out @/bad.png --size 0x8
2 voxrt_render @/s.vox --out @/bad.png --aa nan
2 voxrt_view
2 voxrt_gi
2 voxrt_gi --scene cornell --out @/bad.png --grid 100
2 voxrt_gi --scene cornell --out @/bad.png --pixel 3,4
2 zbufrand_render --scene forest --out @/bad.png --tolerance 2
2 zbufrand_render --scene forest --depth @/bad.png
2 zbufrand_render --scene chess --out @/bad.png --scatter 2
2 zbufrand_render --scene chess --out @/bad.png --view 3
2 zbufrand_render --scene chess --out @/bad.png --density 2 --tolerance 0.1
2 zbufrand_render --scene chess --out @/bad.png --mean 2 --noise 0.1
2 zbufrand_render --scene chess --out @/bad.png --epsilon 2
2 zbufrand_render --scene chess --out @/bad.png --opacity 0.5,
2 zbufrand_render --scene chess --out @/bad.png --mode layers --mean 2
2 zbufrand_render --scene chess --out @/bad.png --contrast 2
2 zbufrand_render --scene chess --out @/bad.png --buckets 8
2 zbufrand_render --scene chess --out @/bad.png --points 9 --aa 2
2 tetcast_render --out @/bad.png
2 tetcast_render --scene lattice --out @/bad.png --model iso
2 tetcast_render --scene lattice --out @/bad.png --model emission --iso 0.5
2 tetcast_render --scene lattice --out @/bad.png --method strips --cells tet8
2 tetcast_render --scene lattice --out @/bad.png --method project --shader lit
2 tetcast_render --scene lattice --out @/bad.png --method project --cut 1,0,0
2 tetcast_render --scene lattice --out @/bad.png --cut 0,0,0
2 tetcast_render --scene lattice --out @/bad.png --integrator riemann --tolerance 1
2 tetcast_render --scene lattice --out @/bad.png --eye 1,2,3 --at 1,2,3
2 tetcast_render --scene lattice --out @/bad.png --clip 3,2,0
2 tetcast_render --scene lattice --out @/bad.png --surface @/bad.obj
2 tetcast_render --scene lattice --out @/bad.png --light 1,0,0
2 tetcast_render --scene lattice --out @/bad.png --shader shadow --model emission
2 tetcast_bricks
2 tetcast_bricks render --out @/bad.png
2 tetcast_bricks render --scene ball --reference ball --out @/bad.pfm
2 tetcast_bricks slice --scene ball --out @/bad.bmp
2 tetcast_bricks slice --scene ball --out @/bad.png --depth @/bad.pfm
2 tetcast_rbf
2 tetcast_rbf render @/ball.rbf --inside ball --half 1,0,0 --out @/bad.png
2 tetcast_rbf render @/garbage.rbf
2 tetcast_rbf decode @/ball.rbf @/bad.brk --start @/ball.rbf
"
exit_statuses() {
    local d=$OUT/obj/exits want line got bad=0
    rm -rf "$d"; mkdir -p "$d"
    printf 'v 0 0 nothing\nf 1 2 3\n' > "$d/garbage.obj"; cp "$d/garbage.obj" "$d/garbage.brk"; cp "$d/garbage.obj" "$d/garbage.rbf"
    printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' > "$d/one.obj"
    tetrahedron() { # LENGTH DATA VALUES
        printf '# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n0 0 0 %s 0 0 0 1 0 0 0 1\n' "$1"
        printf 'CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n%s\nSCALARS s float\nLOOKUP_TABLE default\n%s\n' "$2" "$3"
    }
    tetrahedron 1 'POINT_DATA 4' 'nan nan nan nan' > "$d/nan.vtk"
    tetrahedron 1e30 'POINT_DATA 4' '0 1 2 3' > "$d/huge.vtk"
    tetrahedron 1 'CELL_DATA 1' 7 > "$d/cell.vtk"
    while read -r want line; do
        [ -n "$want" ] || continue
        [ -f "$d/s.vox" ] && [ ! -f "$d/cut.vox" ] && head -c 100 "$d/s.vox" > "$d/cut.vox"
        timeout 60 build/${line//@/$d} > "$d/out" 2> "$d/err" < /dev/null; got=$?
        [ $got = "$want" ] || { echo "$line: status $got, not $want"; bad=1; }
        [ "$want" = 0 ] || [ "$(wc -l < "$d/err")" = 1 ] || { echo "$line: not one line on stderr:"; cat "$d/err"; bad=1; }
    done <<< "$EXITS"
    ls "$d" | grep -F bad. && { echo "was written after an error"; bad=1; }
    return $bad
}
bricks_options() { # --average, --focus, --view of tetcast_bricks against what they have to be the same as, or differ from
    local d=$OUT/obj/bricks b=build/tetcast_bricks i n bad=0
    local r="resample --scene ball --detail 8 --longest 65 --quiet" s="--normal 0,0,1 --at 0,0,0 --size 32x32" p="--size 32x32 --quiet"
    rm -rf "$d"; mkdir -p "$d"
    $b $r "$d/all.brk" && $b $r "$d/wide.brk" --focus 0,0,0 --radius 1000 && $b $r "$d/near.brk" --focus 1,0,0 --radius 0.1 &&
        $b $r "$d/mean1.brk" --average --threads 1 && $b $r "$d/mean3.brk" --average --threads 3 || return 1
    cmp "$d/all.brk" "$d/wide.brk" || { echo "--focus: all that is near is not all"; bad=1; }
    [ "$(wc -c < "$d/near.brk")" -lt "$(($(wc -c < "$d/all.brk") * 3 / 4))" ] || { echo "--focus: no fewer bricks"; bad=1; }
    cmp "$d/mean1.brk" "$d/mean3.brk" || { echo "--average: threads"; bad=1; }
    cmp -s "$d/mean1.brk" "$d/all.brk" && { echo "--average: the values at nodes"; bad=1; }
    for i in scalar auto; do # a plane seen straight on: twice as far away at half the tangent is the same picture
        $b slice "$d/all.brk" $s --view --eye 0,0,2 --fov 90 --isa $i --out "$d/2$i.png" &&
            $b slice "$d/all.brk" $s --view --eye 0,0,4 --fov 53.13010235415598 --isa $i --out "$d/4$i.png" || return 1
        cmp "$d/2$i.png" "$d/4$i.png" || { echo "--view, $i: distance and angle"; bad=1; }
    done
    cmp "$d/2scalar.png" "$d/2auto.png" || { echo "--view: instructions"; bad=1; }
    $b slice "$d/all.brk" $s --view --eye 0,0,3 --fov 90 --out "$d/3.png" || return 1
    cmp -s "$d/2auto.png" "$d/3.png" && { echo "--view: from farther away the same"; bad=1; }
    $b render "$d/all.brk" $p --out "$d/r.png" && $b render "$d/all.brk" $p --focus 0,0,0 --radius 1000 --out "$d/rw.png" &&
        $b render "$d/all.brk" $p --focus 9,9,9 --radius 0.1 --out "$d/rf.png" || return 1
    cmp "$d/r.png" "$d/rw.png" || { echo "render --focus: all that is near is not all"; bad=1; }
    cmp -s "$d/r.png" "$d/rf.png" && { echo "render --focus: from far away the same"; bad=1; }
    have mpicc && have mpirun || return $bad # several frames by one process and by three
    cmd mpicc -std=c99 -O1 -ffp-contract=off -I. -Iexamples -o "$d/mpi" examples/mpi/tetcast_mpi.c -lm -lpthread || return 1
    for n in 1 3; do
        OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 timeout 60 mpirun --oversubscribe -n $n "$d/mpi" "$d/all.brk" "$d/n$n.png" 32x32 lossless 3 \
            > "$d/mpi.out" 2>&1 || { cat "$d/mpi.out"; return 1; }
    done
    for i in "" -2 -3; do cmp "$d/n1$i.png" "$d/n3$i.png" || { echo "MPI, frame ${i#-}: processes"; bad=1; }; done
    cmp -s "$d/n1.png" "$d/n1-2.png" && { echo "MPI: the second frame is the first"; bad=1; }
    return $bad
}
files_and_views() { # a depth without a picture, values of a plane, the angle of a camera that the scene brings along
    local d=$OUT/obj/files bad=0 f
    rm -rf "$d"; mkdir -p "$d"
    build/voxrt_gi --scene cornell --depth "$d/depth.pfm" --size 32x24 --aa 1 --rays 4 --quiet && [ "$(wc -c < "$d/depth.pfm")" -gt 3072 ] || { echo "voxrt_gi --depth"; bad=1; }
    build/tetcast_bricks slice --scene fins --out "$d/plane.pfm" --size 32x24 && [ "$(head -n 1 "$d/plane.pfm")" = Pf ] || { echo "slice: values"; bad=1; }
    for f in "" "--fov 10"; do
        build/zbufrand_render --scene chess --size 32x24 --quiet --out "$d/chess$f.png" $f &&
            build/voxrt_gi --scene cornell --size 32x24 --aa 1 --rays 4 --quiet --out "$d/cornell$f.png" $f || bad=1
    done
    for f in chess cornell; do cmp -s "$d/$f.png" "$d/$f--fov 10.png" && { echo "$f: --fov changes nothing"; bad=1; }; done
    build/voxrt_gi --scene cornell --size 32x24 --aa 1 --rays 4 --quiet --fov 38 --out "$d/same.png" && cmp "$d/same.png" "$d/cornell.png" || bad=1
    return $bad
}
fuzz_bounds() { # 10^8 points of surfaces below the bounds that decide how many samples there are
    cmd make --no-print-directory build/tests/test_zbufrand_select && TEST_FULL=1 cmd timeout 300 build/tests/test_zbufrand_select -v never_too_few
}
stats_keys() { # what zbufrand_render --stats says, for one picture, a mean, layers: one JSON object with these keys, no NaN in it
    local how k bad=0
    for how in "" "--mean 3" "--mode layers" "--aa 2" "--points 5000" "--thesis"; do
        build/zbufrand_render --scene landscape --out "$OUT/obj/stats.png" --size 64x48 --stats --quiet $how > "$OUT/obj/stats" || return 1
        [ "$(wc -l < "$OUT/obj/stats")" = 1 ] && grep -q '^{.*}$' "$OUT/obj/stats" || { echo "$how: not one object"; bad=1; }
        grep -qE ':(-?nan|-?inf)' "$OUT/obj/stats" && { echo "$how: not finite"; bad=1; }
        for k in in width height triangles stored_triangles bytes samples accepted rastered density projected_area nodes draws hidden covered \
                 holes wrong repaired incomplete probability frames rmse stages select draw occlusion repair shade eye at seconds isa threads; do
            grep -q "\"$k\":" "$OUT/obj/stats" || { echo "$how: no $k"; bad=1; }
        done
        have python3 && { python3 -c 'import json,sys; json.load(sys.stdin)' < "$OUT/obj/stats" || { echo "$how: no JSON"; bad=1; }; }
    done
    return $bad
}
help_same() { bash tests/help_blocks.sh docs/programs.md build | diff docs/programs.md - && return 0
    echo "bash tests/help_blocks.sh docs/programs.md build > new; mv new docs/programs.md"; return 1; }
edit_finishes() { # --edit of voxrt_convert: what lines with finishes leave in the file, and what is wrong in one; planes and spread stay
    local d=$OUT/obj/edits text want got bad=0
    mkdir -p "$d"
    edited() { printf "$1" > "$d/e.txt"; build/voxrt_convert --scene sphere "$d/e.vox" --res 32 --quiet --stats --edit "$d/e.txt" 2> "$d/err"; }
    while read -r want text; do
        got=$(edited "$text" | grep -o '"finishes":[0-9]*'); got=${got#*:}
        [ "$got" = "$want" ] || { echo "$text: $got finishes, not $want"; cat "$d/err"; bad=1; }
    done <<'EOF'
0 finish mirror 0.8\nfinish plain\nset box 0 0 0 2 2 2 9 9 9\n
1 finish mirror 0.8 0.7 0.6 diffuse 0.5\r\nset box 0 0 0 2 2 2 9 9 9\r\nfinish plain\r\nset sphere 0 0 0 0.5 0 0 0
2 finish transparency 1 refraction 1.5 absorption 0 1 2 # glass\nset box 0 0 0 2 2 2 9 9 9\nfinish emission 2\npaint sphere -1 0 0 0.5 0 0 0
0 finish specular 1 shininess 20\npaint sphere 1 0 0 0.5 0 0 0\nundo\nclear sphere 1 0 0 0.5
EOF
    for text in finish 'finish mirror' 'finish mirror 1 1' 'finish mirror 1 1 1 1' 'finish mirror x' 'finish mirror 1.1' 'finish mirror -1' \
                'finish refraction 2 2 2' 'finish brass 1' 'finish plain 1' 'finish mirror nan' 'finish refraction 0.01\nset box 0 0 0 1 1 1 0 0 0'; do
        edited "$text\n"; got=$?
        [ $got = 1 ] && [ "$(wc -l < "$d/err")" = 1 ] || { echo "$text: status $got"; cat "$d/err"; bad=1; }
    done
    printf 'clear box 0 0 0 2 2 2\n' > "$d/e.txt"
    build/voxrt_convert --scene sphere "$d/e.vox" --res 32 --planes --spread --quiet --edit "$d/e.txt" 2> "$d/err" &&
        [ $(($(od -An -tu1 -j32 -N1 "$d/e.vox") & 160)) = 160 ] || { echo "edits lose planes or spread"; cat "$d/err"; bad=1; }
    return $bad
}
group_programs() {
    local f name
    for f in tests/all_*.c; do # mains and locals of one file meet names of others
        item "programs gcc $f" c gcc -std=c99 -fsyntax-only -Wno-missing-prototypes -Wno-shadow $STATIC "$f"
    done
    for f in $(ls examples/*.c examples/web/*.c tests/test_*.c tests/fuzz/*.c bench/*.c bench/peers/*.c 2>/dev/null); do
        [ -n "$SHORT" ] && grep -qs "\"${f##*/}\"" tests/all_*.c && continue # alone it is compiled in the long form
        item "programs gcc $f" c gcc -std=c99 -fsyntax-only "$f"
        [ -n "$SHORT" ] && [ "${f#examples}" = "$f" ] || item "programs clang $f" c clang -std=c99 -fsyntax-only "$f"
    done
    for f in $(ls *.c 2>/dev/null); do item "programs $f" c gcc -std=c99 -O0 -c -o /dev/null "$f"; done
    for f in $(ls examples/support/*.h bench/baseline/*.h tests/*.h 2>/dev/null); do
        grep -q '# *error "include ' "$f" && continue # a part of another one
        name=$OUT/tu/$(echo "$f" | tr / _).c
        printf '#include "%s"\n#include "%s"\n' "$f" "$f" > "$name"
        item "programs include $f" c gcc -std=c99 -fsyntax-only -Wno-unused-function "$name"
    done
    # those whose system is installed
    solo "programs peers" make -j"$JOBS" B="$OUT/peers" PEER_CXXFLAGS="-std=c++17 -fsyntax-only -Wall -Wextra -Werror -march=native" peers
    solo "programs examples" make -j"$JOBS" examples
    solo "programs benches" make -j"$JOBS" B="$OUT/benches" OPT="-O1 ${SHORT:+$STATIC}" benches # not those that are to be fast
    solo "programs exit statuses" exit_statuses
    [ -f tetcast.h ] && item "programs bricks' options" bricks_options
    [ ${#HEADERS[@]} = 3 ] && item "programs files and views" files_and_views
    item "programs docs/programs.md says what --help says" help_same
    [ -f zbufrand.h ] && item "programs stats keys" stats_keys
    [ -f zbufrand.h ] && [ -z "$SHORT" ] && item "programs 10^8 points" fuzz_bounds
    [ -f voxrt.h ] && item "programs edits give finishes" edit_finishes
    solo "programs make demo" timeout 400 make -j"$JOBS" demo
}

# --- readme: code blocks and the program in the header's comment -------------------------------------------------

readme_block() { # FILE LANGUAGE
    local d=$OUT/obj/readme.$BASHPID rc
    if [ $2 = c ]; then cmd gcc -std=c99 -O0 -Wall -Wextra -Werror -I. -Iexamples -o "$d" "$1" -lm -lpthread
    else cmd g++ -x c++ -std=c++11 -O0 -Wall -Wextra -Werror -I. -Iexamples -o "$d" "$1" -lm -lpthread; fi
    rc=$?; rm -f "$d"; return $rc
}
squeeze() { sed -e 's/^[ *]*//' -e 's/[ ]*$//' "$1" | grep -v '^$'; }
minimal_same() { # NAME: the example, from its first # line, stands in the header's first comment
    local f=examples/minimal_$1.c
    [ -f $f ] || { echo "no $f"; return 1; }
    [ "$(wc -l < $f)" -lt 100 ] || { echo "$f is not under 100 lines"; return 1; }
    sed -n '/^#/,$p' $f > "$OUT/tu/$1/minimal"; squeeze "$OUT/tu/$1/minimal" > "$OUT/tu/$1/minimal_example"
    local first count start; first=$(head -n 1 "$OUT/tu/$1/minimal_example"); count=$(wc -l < "$OUT/tu/$1/minimal_example")
    awk '/\*\// { exit } { print }' $1.h > "$OUT/tu/$1/comment"; squeeze "$OUT/tu/$1/comment" > "$OUT/tu/$1/comment_s"
    for start in $(grep -nxF -- "$first" "$OUT/tu/$1/comment_s" | cut -d: -f1); do
        tail -n +$start "$OUT/tu/$1/comment_s" | head -n $count > "$OUT/tu/$1/minimal_header"
        diff -u "$OUT/tu/$1/minimal_example" "$OUT/tu/$1/minimal_header" && return 0
    done
    echo "$1.h does not quote $f"; return 1
}
links() { # FILE: what it links to in this tree is there, headings too
    local bad=0 at file head
    while IFS= read -r at; do
        case $at in http*:* | mailto:*) continue ;; esac
        file=${at%%#*}; head=; [ "$at" = "$file" ] || head=${at#*#}
        if [ -z "$file" ]; then file=$1; else file=$(dirname "$1")/$file; fi
        [ -e "$file" ] || { echo "$1: no $at"; bad=1; continue; }
        [ -z "$head" ] || sed -n 's/^##* *//p' "$file" | tr 'A-Z ' 'a-z-' | tr -cd 'a-z0-9_\n-' | grep -qxF -- "$head" ||
            { echo "$1: no heading $at"; bad=1; }
    done < <(grep -o '](\([^)]*\))' "$1" | sed 's/^](//; s/)$//; s/ .*//')
    return $bad
}
group_readme() {
    local n f lang k=0 d=$OUT/tu/readme
    rm -rf "$d"; mkdir -p "$d"
    for f in README.md docs/*.md; do
        [ -f "$f" ] || continue
        awk -v d="$d" -v base="$(basename "$f" .md)" '
            /^```(c|cpp|c\+\+)$/ { lang = $0 == "```c" ? "c" : "cc"; text = ""; on = 1; at = FNR; next }
            /^```/ { if (on && text ~ /int main *\(/) { name = d "/" base "_line" at "." lang; printf "%s", text > name; close(name) } on = 0; next }
            on { text = text $0 "\n" }' "$f"
    done
    for f in *.md docs/*.md; do item "readme links of $f" links "$f"; done
    for f in "$d"/*; do
        [ -f "$f" ] || continue
        lang=${f##*.}; k=$((k + 1)); item "readme $(basename "$f")" readme_block "$f" $lang
    done
    [ $k -gt 0 ] || item "readme code" skip "no code block with main in README.md"
    for n in "${HEADERS[@]}"; do item "readme minimal_$n.c stands in $n.h" minimal_same $n; done
}

# --- install -----------------------------------------------------------------------------------------------------

install_make() {
    local d=$ROOT/$OUT/install n
    rm -rf "$d"; cmd make --no-print-directory install DESTDIR="$d" PREFIX=/opt/x || return 1
    for n in "${HEADERS[@]}"; do
        [ -f "$d/opt/x/include/$n.h" ] || { echo "no $n.h"; return 1; }
        [ -f "$d/opt/x/share/pkgconfig/$n.pc" ] || { echo "no $n.pc"; return 1; }
        grep -E '^Version: [0-9]+\.[0-9]+\.[0-9]+$' "$d/opt/x/share/pkgconfig/$n.pc" || { echo "$n.pc: no version"; return 1; }
        if have pkg-config; then PKG_CONFIG_PATH=$d/opt/x/share/pkgconfig cmd pkg-config --cflags --libs $n || return 1; fi
    done
}
version_of() { head -n 1 $1.h | sed 's/.* - v\([0-9.]*\) - .*/\1/'; }
install_cmake() { # as a folder of another project; installed, each header by its own package
    have cmake || skip "no cmake" || return
    local d=$ROOT/$OUT/cmake n=${HEADERS[0]} v; rm -rf "$d"; mkdir -p "$d/app" "$d/found"
    printf 'cmake_minimum_required(VERSION 3.14)\nproject(app C)\nadd_subdirectory(%s lib)\nadd_executable(app %s %s)\ntarget_link_libraries(app voxrt::headers)\n' \
        "$ROOT" "$ROOT/$OUT/tu/$n/use.c" "$ROOT/$OUT/tu/$n/impl.c" > "$d/app/CMakeLists.txt"
    cmd cmake -S "$d/app" -B "$d/build" && cmd cmake --build "$d/build" && "$d/build/app" || return 1
    cmd cmake -S "$ROOT" -B "$d/lib" -DCMAKE_INSTALL_PREFIX="$d/prefix" && cmd cmake --install "$d/lib" || return 1
    printf 'cmake_minimum_required(VERSION 3.14)\nproject(app C)\nfind_package(voxrt 99 QUIET)\nif(voxrt_FOUND)\nmessage(FATAL_ERROR "version 99")\nendif()\n' > "$d/found/CMakeLists.txt"
    for n in "${HEADERS[@]}"; do
        v=$(version_of $n)
        printf 'find_package(%s %s REQUIRED)\nif(NOT %s_VERSION VERSION_EQUAL %s)\nmessage(FATAL_ERROR "version ${%s_VERSION}")\nendif()\n' $n ${v%.*} $n $v $n
        printf 'add_executable(use_%s %s %s)\ntarget_link_libraries(use_%s %s::%s)\n' $n "$ROOT/$OUT/tu/$n/use.c" "$ROOT/$OUT/tu/$n/impl.c" $n $n $n
        [ -f "$d/prefix/share/pkgconfig/$n.pc" ] && grep -qx "Version: $v" "$d/prefix/share/pkgconfig/$n.pc" || { echo "$n.pc"; return 1; }
    done >> "$d/found/CMakeLists.txt"
    cmd cmake -S "$d/found" -B "$d/found/build" -DCMAKE_PREFIX_PATH="$d/prefix" && cmd cmake --build "$d/found/build" || return 1
    for n in "${HEADERS[@]}"; do "$d/found/build/use_$n" || return 1; done
}
install_meson() { # as a subproject, by the wrap file that is there; installed
    have meson && have ninja || skip "no meson" || return
    local d=$ROOT/$OUT/meson n=${HEADERS[0]} v; rm -rf "$d"; mkdir -p "$d/app/subprojects"; ln -s "$ROOT" "$d/app/subprojects/$n"
    cp "$OUT/tu/$n/use.c" "$OUT/tu/$n/impl.c" "$d/app"
    cp voxrt.wrap "$d/app/subprojects"
    echo "project('app', 'c')" > "$d/app/meson.build"
    for v in "${HEADERS[@]}"; do
        echo "assert(dependency('$v', version: '>=$(version_of $v)').version() == '$(version_of $v)')"
        echo "assert(not dependency('$v', version: '>=99', required: false).found())"
    done >> "$d/app/meson.build"
    echo "executable('app', 'use.c', 'impl.c', dependencies: dependency('$n'))" >> "$d/app/meson.build"
    cmd meson setup "$d/build" "$d/app" && cmd meson compile -C "$d/build" && "$d/build/app" || return 1
    cmd meson setup "$d/lib" . --prefix "$d/prefix" && cmd meson install -C "$d/lib" || return 1
    for n in "${HEADERS[@]}"; do
        [ -f "$d/prefix/include/$n.h" ] && grep -qx "Version: $(version_of $n)" "$d/prefix/share/pkgconfig/$n.pc" || { echo "no $n.h or $n.pc"; return 1; }
    done
}
group_install() { item "install make" install_make; item "install cmake" install_cmake; item "install meson" install_meson; }

# --- modes, sanitizers, emulators: the quick tests once more -----------------------------------------------------

test_names() { # GROUP-NAME
    local f n; for f in tests/test_*.c; do n=$(basename "$f" .c); matches "$1:${n#test_}" "$SKIP_TESTS" || echo "$n"; done
}
one_test() { # PROGRAM [COMMAND BEFORE...]
    local p=$1 rc; shift
    ulimit -t "$ITEM_TIMEOUT" # of the processor's time; on the clock four times as much, as others may be at work
    TEST_QUICK=1 cmd timeout $((4 * ITEM_TIMEOUT)) "$@" "$p" -v; rc=$?
    [ $rc -ne 124 ] && [ $rc -ne 137 ] && [ $rc -ne 152 ] || echo "took more than $ITEM_TIMEOUT s"
    return $rc
}
long_test() { TEST_QUICK=0 cmd timeout 400 "$1"; }
group_long() { # what `make test` runs, at its full length
    local t
    solo "long build" make -k -j"$JOBS" --no-print-directory tests
    for t in tests/test_*.c; do
        t=${t##*/}; t=${t%.c}
        [ -n "$SHORT" ] && matches $t "$LONG_BY_HAND" || item "long $t" long_test "build/tests/$t"
    done
    barrier
}
build_and_test() { # GROUP NAME COMPILER FLAGS LDFLAGS [COMMAND BEFORE...]
    local group=$1 name=$2 cc=$3 flags=$4 ld=$5 t; shift 5
    local b=$OUT/$name list=(); mapfile -t list < <(test_names $group-$name)
    [ ${#list[@]} -gt 0 ] || { run_item "$group $name" skip "no test left for it in SKIP_TESTS"; return; }
    solo "$group $name build" make -k -j"$JOBS" --no-print-directory B="$b" CC="$cc" CFLAGS="$flags" LDFLAGS="$ld" "${list[@]/#/$b/tests/}"
    for t in "${list[@]}"; do
        [ -f "$b/tests/$t" ] && item "$group $name $t" one_test "$b/tests/$t" "$@"
    done
    barrier
}
works() { # COMPILER FLAGS...: makes and runs a program
    local p=$OUT/obj/works; rm -f "$p"; echo 'int main(void) { return 0; }' > "$p.c"
    "$@" -o "$p" "$p.c" -lm -lpthread > "$p.log" 2>&1 && "$p" >> "$p.log" 2>&1
}
works_in() { # COMPILER-AND-FLAGS SUFFIX COMMAND BEFORE...: the same for a machine that is not this one
    local p=$OUT/obj/works_in$2 make=$1; shift 2; rm -f "$p"; echo 'int main(void) { return 0; }' > "${p%.*}.c"
    $make -o "$p" "${p%.*}.c" -lm > "$p.log" 2>&1 && timeout 120 "$@" "$p" >> "$p.log" 2>&1
}
group_modes() {
    local name cc flags
    while read -r name cc flags; do
        [ -n "$name" ] || continue
        flags=$(fill "$flags" | tr '\n' ' ')
        if works $cc $flags; then build_and_test modes $name $cc "$flags" ""
        elif [ "${flags/-m32/}" != "$flags" ] && have qemu-i386 && works_in "$cc $flags" .m32 qemu-i386; then # not every kernel runs them
            build_and_test modes $name $cc "$flags" "" qemu-i386
        else run_item "modes $name" skip "$cc $flags makes no program here"; fi
    done <<< "$MODES"
}
group_sanitize() {
    local name cc flags before
    export ASAN_OPTIONS=allocator_may_return_null=1 UBSAN_OPTIONS=print_stacktrace=1 TSAN_OPTIONS=halt_on_error=1
    while read -r name cc flags; do
        [ -n "$name" ] || continue
        before=
        if ! works $cc $SAN_FLAGS $flags; then
            # the address layout of some kernels is too random for tsan and msan
            if have setarch && [ -x "$OUT/obj/works" ] && setarch "$(uname -m)" -R "$OUT/obj/works" 2>/dev/null; then before="setarch $(uname -m) -R"
            else run_item "sanitize $name" skip "$cc $flags makes no program that runs here"; continue; fi
        fi
        build_and_test sanitize $name $cc "$SAN_FLAGS $flags" "" $before
    done <<< "$SANITIZERS"
}
group_emulate() {
    local name cc emu flags
    while read -r name cc emu flags; do
        [ -n "$name" ] || continue
        if have $cc && have $emu; then build_and_test emulate $name $cc "-std=c99 -O2 -ffp-contract=off $flags" -static $emu
        else run_item "emulate $name" skip "no $cc or no $emu"; fi
    done <<< "$EMULATE"
}

same_files() { # COMPILER FLAGS COMMAND BEFORE...: a voxel file and a picture by programs of another machine and of this one, byte by byte
    local cc=$1 flags=$2 d=$OUT/obj/same.$BASHPID p; shift 2
    mkdir -p "$d"; cmd make --no-print-directory build/voxrt_convert build/voxrt_render || return 1
    for p in voxrt_convert voxrt_render; do
        cmd $cc -std=c99 -O1 -ffp-contract=off $STATIC -I. $flags -o "$d/$p.js" examples/$p.c -lm -lpthread || return 1 # .js: the name is kept
    done
    build/voxrt_convert --scene menger "$d/here.vox" --res 81 --quiet && build/voxrt_render "$d/here.vox" --out "$d/here.png" --size 160x120 --shadows --quiet &&
    cmd "$@" "$d/voxrt_convert.js" --scene menger "$d/there.vox" --res 81 --quiet &&
    cmd "$@" "$d/voxrt_render.js" "$d/there.vox" --out "$d/there.png" --size 160x120 --shadows --quiet &&
    cmd "$@" "$d/voxrt_convert.js" --scene menger "$d/there.vox" --res 81 --quiet && # in the place of what is there
    cmd cmp "$d/here.vox" "$d/there.vox" && cmd cmp "$d/here.png" "$d/there.png"
    p=$?; rm -rf "$d"; return $p
}
group_windows() {
    local name cc ld
    export WINEPREFIX=$ROOT/$OUT/wine WINEDEBUG=-all # a folder of its own, made by the first program that runs
    while read -r name cc ld; do
        [ -n "$name" ] || continue
        if ! have $cc || ! have wine; then run_item "windows $name" skip "no $cc or no wine"; continue; fi
        if ! works_in "$cc $ld" .exe wine; then run_item "windows $name" skip "$cc makes no program that wine runs"; continue; fi
        item "windows $name files" same_files $cc "-D__USE_MINGW_ANSI_STDIO=1 $ld" wine
        build_and_test windows $name $cc "-std=c99 -O1 -ffp-contract=off -D__USE_MINGW_ANSI_STDIO=1" "$ld" wine
    done <<< "$WINDOWS"
    have wineserver && wineserver -k # of this folder
}
group_wasm() {
    local name flags
    [ ! -d /usr/share/nodejs ] || export NODE_PATH=/usr/share/nodejs # where Debian has what emcc needs
    while read -r name flags; do
        [ -n "$name" ] || continue
        if ! have emcc || ! have node; then run_item "wasm $name" skip "no emcc or no node"; continue; fi
        if ! works_in "emcc $flags $WASM_FLAGS" .js $NODE; then run_item "wasm $name" skip "emcc $flags makes no program that node runs"; continue; fi
        item "wasm $name files" same_files emcc "$flags $WASM_FLAGS" $NODE
        build_and_test wasm $name emcc "-std=c99 -O1 -ffp-contract=off $flags $WASM_FLAGS" "" $NODE
    done <<< "$WASM"
}

# --- fuzz: tests/fuzz/fuzz_*.c, seeds in tests/fuzz/corpus/NAME/ -------------------------------------------------
# With FUZZ_FIXED=N nothing depends on coverage: the seeds and the first N changes of them, less on slow machines, always
# the same ones. This is what a change is judged by; the search for new inputs is FUZZ_SECONDS.

fuzz_standalone() { # NAME -seconds=N|-iterations=N
    local p=$OUT/fuzz/$1.standalone
    # -Og compiles three times as long as -O0 and runs in two fifths of the time; places of variables take half of compiling
    cmd gcc $SAN_FLAGS $([ -n "$SHORT" ] && echo -O0 || echo -Og) -g1 -fno-var-tracking $STATIC -fsanitize=address,undefined -fno-sanitize-recover=all -I. -o "$p" tests/fuzz/$1.c tests/fuzz/standalone.c -lm -lpthread &&
    cmd timeout $((600 + FUZZ_EACH + SOAK_SECONDS)) "$p" $2 -crash="$OUT/fuzz/$1.crash" $( [ -d tests/fuzz/corpus/${1#fuzz_} ] && echo tests/fuzz/corpus/${1#fuzz_} )
}
fuzz_libfuzzer() { # NAME SECONDS
    local p=$OUT/fuzz/$1.libfuzzer dict= seeds= compare=-fno-sanitize-coverage=trace-cmp
    # what is compared with bytes of the input helps with formats alone, and takes four fifths of the time of the others
    case " $FUZZ_FORMATS " in *" ${1#fuzz_} "*) compare= ;; esac
    [ -f tests/fuzz/${1#fuzz_}.dict ] && dict=-dict=tests/fuzz/${1#fuzz_}.dict
    [ -d tests/fuzz/corpus/${1#fuzz_} ] && seeds=tests/fuzz/corpus/${1#fuzz_}
    mkdir -p "$OUT/fuzz/$1.found"
    cmd clang $SAN_FLAGS $STATIC -fsanitize=fuzzer,address,undefined $compare -fno-sanitize-recover=all -I. -o "$p" tests/fuzz/$1.c -lm -lpthread &&
    cmd timeout $((600 + FUZZ_EACH)) "$p" -max_total_time=$2 -timeout=10 -rss_limit_mb=3000 -seed=1 -error_exitcode=1 -timeout_exitcode=1 -print_final_stats=1 \
        -artifact_prefix="$OUT/fuzz/$1." $dict "$OUT/fuzz/$1.found" $seeds
}
group_fuzz() {
    local names=() f each libfuzzer=0
    mkdir -p "$OUT/fuzz"; rm -rf "$OUT"/fuzz/*
    export ASAN_OPTIONS=allocator_may_return_null=1
    for f in tests/fuzz/fuzz_*.c; do [ -f "$f" ] && names+=("$(basename "$f" .c)"); done
    if [ ${#names[@]} -eq 0 ]; then run_item "fuzz" skip "no tests/fuzz/fuzz_*.c"; return; fi
    printf '#include <stddef.h>\n#include <stdint.h>\nint LLVMFuzzerTestOneInput(const uint8_t *d, size_t n);\nint LLVMFuzzerTestOneInput(const uint8_t *d, size_t n) { (void)d; (void)n; return 0; }\n' > "$OUT/tu/fuzz_nothing.c"
    clang -fsanitize=fuzzer,address,undefined -o "$OUT/tu/fuzz_nothing" "$OUT/tu/fuzz_nothing.c" 2>/dev/null && libfuzzer=1
    each=$((FUZZ_SECONDS * JOBS / ${#names[@]})); [ $each -ge 2 ] || each=2
    [ $each -le "$FUZZ_SECONDS" ] || each=$FUZZ_SECONDS
    [ -z "$FUZZ_EACH" ] || each=$FUZZ_EACH
    for f in "${names[@]}"; do
        if [ -n "$FUZZ_FIXED" ]; then
            item "fuzz $f up to $FUZZ_FIXED changes, 5 s" fuzz_standalone $f "-iterations=$FUZZ_FIXED -seconds=5 -prefixes=3"
        elif [ $libfuzzer = 1 ]; then
            item "fuzz $f libfuzzer $each s" fuzz_libfuzzer $f $each
            item "fuzz $f standalone 2 s" fuzz_standalone $f -seconds=2
        else
            item "fuzz $f standalone $each s" fuzz_standalone $f -seconds=$each
        fi
    done
}

# --- soak: random use of the functions of each library for long; memory that is in use must not grow --------------

group_soak() {
    local names="fuzz_build fuzz_trace fuzz_render fuzz_gi fuzz_edit fuzz_scene fuzz_canvas fuzz_tets fuzz_fields fuzz_bricks fuzz_rbf fuzz_vox fuzz_paged fuzz_coded fuzz_foam" f
    local each=$((SOAK_SECONDS / 14)); [ $each -ge 2 ] || each=2
    mkdir -p "$OUT/fuzz"
    export ASAN_OPTIONS=allocator_may_return_null=1
    for f in $names; do [ -f tests/fuzz/$f.c ] && item "soak $f $each s" fuzz_standalone $f "-seconds=$each -seed=77 -prefixes=20"; done
}

# --- analyze: clang's and cppcheck's findings --------------------------------------------------------------------

analyze_clang() { # NAME
    have clang || skip "no clang" || return
    cmd timeout 900 clang --analyze -std=c99 -I. -Xclang -analyzer-output=text -Xclang -analyzer-werror \
        -o /dev/null -D$(upper $1)_IMPLEMENTATION -x c $1.h # as the main file: functions of headers are not analyzed
}
analyze_cppcheck() { # NAME
    have cppcheck || skip "no cppcheck" || return
    # nothing is left out that could keep it from reading the header; legacyUninitvar does not know a ? b : c of arrays
    cmd timeout 600 cppcheck --quiet --std=c99 --language=c --platform=unix64 --enable=warning,portability --inline-suppr --error-exitcode=1 --force --max-configs=2 \
        -D__x86_64__=1 -D__GNUC__=12 -D__SSE2__=1 -D$(upper $1)_IMPLEMENTATION --suppress=missingInclude --suppress=legacyUninitvar $1.h
}
group_analyze() {
    local n
    for n in "${HEADERS[@]}"; do
        [ -n "$SHORT" ] || item "analyze $n clang" analyze_clang $n # minutes for each
        item "analyze $n cppcheck" analyze_cppcheck $n
    done
}

# --- run ---------------------------------------------------------------------------------------------------------

if [ ${#HEADERS[@]} -eq 0 ]; then echo "no header yet"; echo "0 passed, 0 failed, 1 skipped"; exit 0; fi
make_units
for g in ${*:-$GROUPS_ALL}; do
    case " $GROUPS_ALL " in *" $g "*) ;; *) echo "no group $g; there are: $GROUPS_ALL" >&2; exit 2 ;; esac
    t0=$SECONDS
    group_$g
    barrier
    awk -v g=$g -v t=$((SECONDS - t0)) '$3 == g { n[$1]++ }
        END { printf "%-9s %4d ok", g, n["ok"]; if (n["FAIL"]) printf ", %d failed", n["FAIL"]; if (n["skip"]) printf ", %d skipped", n["skip"]; printf "  (%d s)\n", t }' "$OUT/results"
done
awk '{ n[$1]++ } END { printf "%d passed, %d failed", n["ok"], n["FAIL"]; if (n["skip"]) printf ", %d skipped", n["skip"]; print ""; exit n["FAIL"] != 0 }' "$OUT/results"
