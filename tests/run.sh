#!/bin/sh
# Run test programs, print one line for each and the output of those that fail or skip; the last line is the sum.
#   sh tests/run.sh build/tests/test_a build/tests/test_b ...
# JOBS=N programs at a time (default: one per core), TEST="words" and V=1 are handed to each program as its filter
# and -v, TEST_TIMEOUT=seconds for each (default 170), TEST_RUN=command before each (an emulator).
if [ "$1" = --one ]; then
    program=$2; log=$2.log; limit=
    command -v timeout >/dev/null 2>&1 && limit="timeout ${TEST_TIMEOUT:-170}"
    start=$(date +%s)
    # shellcheck disable=SC2086
    $limit $TEST_RUN "$program" ${V:+-v} $TEST >"$log" 2>&1
    status=$?
    seconds=$(($(date +%s) - start))
    sum=$(tail -n 1 "$log" | grep -E '^[0-9]+ passed, [0-9]+ failed(, [0-9]+ skipped)?$')
    if [ -z "$sum" ]; then
        n=$(grep -c '^ok  ' "$log")
        sum="$n passed, 1 failed"; printf '(ended with status %s and no summary)\n%s\n' "$status" "$sum" >>"$log"
    elif [ "$status" -ne 0 ] && echo "$sum" | grep -q ', 0 failed'; then
        sum="$(echo "$sum" | sed 's/, 0 failed/, 1 failed/')"; printf '(ended with status %s)\n%s\n' "$status" "$sum" >>"$log"
    fi
    # one write for each program, so that lines of parallel programs do not mix
    out=$(printf '%-32s %s  (%s s)\n' "${program##*/}" "$sum" "$seconds"
        case $sum in
        *', 0 failed'*) if [ -n "$V" ]; then sed '$d; s/^/    /' "$log"; else grep '^SKIP' "$log" | sed 's/^/    /'; fi ;;
        *) sed '$d' "$log" | tail -n 60 | sed 's/^/    /' ;;
        esac)
    printf '%s\n' "$out"
    exit 0
fi
if [ $# -eq 0 ]; then echo "no test programs"; echo "0 passed, 1 failed"; exit 1; fi
for p in "$@"; do rm -f "$p.log"; done
printf '%s\n' "$@" | xargs -P "${JOBS:-$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2)}" -I '{}' sh "$0" --one '{}'
for p in "$@"; do tail -n 1 "$p.log" 2>/dev/null || echo "0 passed, 1 failed"; done | tr -d ',' | awk '
    { p += $1; f += $3; s += $5 }
    END { printf "%d passed, %d failed", p, f; if (s) printf ", %d skipped", s; print ""; exit f != 0 || p + s == 0 }'
