#!/bin/bash
# Which requests for memory no test refuses: copies the headers so that each call that takes memory notes its line and
# whether it got any, builds the tests with the copies, runs them at full length (TEST_QUICK=1: the quick forms).
#   bash tests/refusals.sh build/refusals voxrt.h ...     lists the lines where memory was given and never refused
# Fails where there is one.
cd "$(dirname "$0")/.." || exit 1
folder=$1; shift
rm -rf "$folder"; mkdir -p "$folder"
git ls-files Makefile examples '*.[ch]' tests | grep -v ^tests/fuzz/ | sort -u | xargs cp --parents -t "$folder"
for h in "$@"; do
    awk -v name="$h" -v p="${h%.h}i" '
        index($0, "static " toupper(p) "_UNUSED void *" p "_alloc(" p "_mem *mem, size_t bytes) {") == 1 {
            print "#include <stdio.h>"
            print "static uint8_t " p "_noted[65536];"
            print "static __thread uint32_t " p "_line;"
            print "static void " p "_noted_write(void) {"
            print "    FILE *f = fopen(getenv(\"REFUSALS\") != NULL ? getenv(\"REFUSALS\") : \"/dev/null\", \"a\");"
            print "    for (uint32_t i = 0; i < 65536; i++) if (f != NULL && " p "_noted[i] != 0) fprintf(f, \"" name " %u %u\\n\", i, " p "_noted[i]);"
            print "    if (f != NULL) fclose(f);"
            print "}"
            print "static void *" p "_alloc_plain(" p "_mem *mem, size_t bytes);"
            print "static " toupper(p) "_UNUSED void *" p "_alloc(" p "_mem *mem, size_t bytes) {"
            print "    static int once;"
            print "    void *p = " p "_alloc_plain(mem, bytes);"
            print "    if (!__atomic_exchange_n(&once, 1, __ATOMIC_SEQ_CST)) atexit(" p "_noted_write);"
            print "    __atomic_or_fetch(&" p "_noted[" p "_line & 65535], p != NULL ? 1 : 2, __ATOMIC_RELAXED);"
            print "    return p;"
            print "}"
            print "static void *" p "_alloc_plain(" p "_mem *mem, size_t bytes) {"
            print "#line " NR + 1 " \"" name "\""
            next
        }
        { print }
        index($0, "static " toupper(p) "_UNUSED int " p "_grow(") == 1 { grow = 1 }
        grow == 1 && /^}/ {
            grow = 2
            n = split("alloc alloc_array alloc_zero grow", call, " ")
            for (i = 1; i <= n; i++) print "#define " p "_" call[i] "(...) (" p "_line = __LINE__, (" p "_" call[i] ")(__VA_ARGS__))"
            print "#line " NR + 1 " \"" name "\""
        }
        END { exit grow != 2 }' "$h" > "$folder/$h" || { echo "$h: no place for the notes"; exit 1; }
done
# shellcheck disable=SC2046
make -C "$folder" --no-print-directory -j"$(nproc)" CC=gcc CFLAGS='-std=gnu99 -g -O1 -ffp-contract=off' tests > "$folder/make.log" 2>&1 ||
    { tail -n 20 "$folder/make.log"; exit 1; }
: > "$folder/notes"
# shellcheck disable=SC2046,SC2010
(cd "$folder" && REFUSALS=$PWD/notes TEST_QUICK=${TEST_QUICK:-0} TEST_TIMEOUT=900 sh tests/run.sh $(ls build/tests/test_* | grep -v '[.]')) > "$folder/run.log"
tail -n 1 "$folder/run.log" | grep -q ', 0 failed' || { cat "$folder/run.log"; exit 1; }
tail -n 1 "$folder/run.log"
status=0
for h in "$@"; do
    awk -v h="$h" -v p="${h%.h}i_" '
        NR == FNR { if ($1 == h) { given[$2] += $3 % 2; refused[$2] += $3 >= 2 } next }
        /^[a-zA-Z].*[(]/ && !/;$/ { match($0, /[a-z0-9_]+[(]/); name = substr($0, RSTART, RLENGTH - 1) }
        index($0, p "alloc") || index($0, p "grow(") { # tests call these, too: other lines are theirs
            if (!given[FNR]) next
            all++
            if (refused[FNR]) got++
            else { sub(/^ */, ""); printf "%s:%d: %s: %s\n", h, FNR, name, $0 }
        }
        END { printf "%-12s %d of %d requests refused\n", h, got, all; exit got < all }' "$folder/notes" "$h" || status=1
done
exit $status
