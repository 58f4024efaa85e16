#!/bin/bash
# Runs the tests that `make coverage` built with --coverage and adds up which lines of the headers they reached.
#   bash tests/coverage.sh build/cov voxrt.h ...      writes build/cov/NAME.uncovered: the lines never reached
# Fails where a header has less than LEAST percent.
cd "$(dirname "$0")/.." || exit 1
folder=$1; shift
LEAST=${LEAST:-90}
status=0; list=()
for f in tests/test_*.c; do list+=("$folder/tests/$(basename "$f" .c)"); done
rm -rf "$folder/gcov"; find "$folder" -name '*.gcda' -delete
TEST_QUICK=1 sh tests/run.sh "${list[@]}" || status=1
# each program has its own copy of the header's functions: a line counts as reached when one test reached it
for f in tests/all_*.c; do list+=("$folder/tests/$(basename "$f" .c)"); done
for p in "${list[@]}"; do
    [ -e "$p.gcno" ] && grep -qs "\"${p##*/}.c\"" tests/all_*.c && rm "$p.gcno" # an older build compiled it alone
    [ -e "$p.gcno" ] || continue
    d=$folder/gcov/$(basename "$p"); mkdir -p "$d"
    # gcov reads the sources, by names relative to where the compiler ran
    for f in tests examples bench *.h; do [ -e "$f" ] && ln -sfn "$PWD/$f" "$d/$f"; done
    (cd "$d" && gcov "$OLDPWD/$p" > /dev/null 2>&1)
done
for h in "$@"; do
    find "$folder/gcov" -name "$h.gcov" -print0 | xargs -0 -r cat | awk -F: -v h="$h" -v least="$LEAST" -v out="$folder/${h%.h}.uncovered" '
        { n = $2 + 0; c = $1; gsub(/[ *]/, "", c) }
        n == 0 || c == "-" { next }
        { seen[n] = 1; if (c !~ /^[#=]+$/) hit[n] = 1; if (!(n in text)) { t = $0; sub(/^[^:]*:[^:]*:/, "", t); text[n] = t } }
        END { for (n in seen) { all++; if (n in hit) got++; else printf "%6d: %s\n", n, text[n] | ("sort -n > " out) }
              if (all) printf "%-12s %d of %d lines reached, %.1f %%\n", h, got, all, 100 * got / all
              else printf "%-12s no test includes it\n", h
              exit !(all && 100 * got >= least * all) }' || status=1
done
exit $status
