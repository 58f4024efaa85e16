# A C compiler and make (GNU) are all that is needed. `make help` lists the targets.
#   make CC=clang            another compiler
#   make B=/tmp/b            another build folder
#   make CFLAGS="-std=c99 -O3 -ffp-contract=off"
# A new file in examples/, tests/ or bench/ needs no change here; a test of one header is named in tests/all_NAME.c.

CC      ?= cc
ifeq ($(origin CC),default)
CC      := cc
endif
CFLAGS  ?= -std=c99 -O2 -ffp-contract=off -Wall -Wextra
OPT     :=
LDFLAGS ?=
LDLIBS  ?= -lm -lpthread
PREFIX  ?= /usr/local
DESTDIR ?=
B       ?= build
G       := $(B)/gallery

HEADERS   := $(wildcard voxrt.h zbufrand.h tetcast.h)
EXAMPLES  := $(patsubst examples/%.c,$(B)/%,$(wildcard examples/*.c))
TESTS     := $(patsubst tests/test_%.c,$(B)/tests/test_%,$(wildcard tests/test_*.c))
BENCHES   := $(patsubst bench/bench_%.c,$(B)/bench_%,$(wildcard bench/bench_*.c))
REPORT    := $(patsubst bench/%.c,$(B)/%,$(wildcard bench/report.c))
ALL_TESTS := $(patsubst tests/%.c,$(B)/tests/%,$(wildcard tests/all_*.c))
PROGRAMS  := $(EXAMPLES) $(TESTS) $(BENCHES) $(REPORT)
GALLERY   :=

# As many jobs as there are processors, unless -j says otherwise.
ifeq ($(filter -j%,$(MAKEFLAGS)),)
MAKEFLAGS += -j$(shell nproc 2>/dev/null || echo 1)
endif

# --- build ---------------------------------------------------------------------------------------

.PHONY: all examples tests benches demo test check fuzz fuzz-long soak bench bench-full report install uninstall clean help \
        test-asan test-tsan test-msan coverage coverage-scalar refusals FORCE

all: $(PROGRAMS)
examples: $(EXAMPLES)
tests: $(ALL_TESTS) $(TESTS)
benches: $(BENCHES) $(REPORT)

# static functions that a program does not use are not compiled: half of the time for a header
STATIC := -DVOXRT_STATIC -DZBUFRAND_STATIC -DTETCAST_STATIC
# -O3 is worth 8 % of the ray rate of voxrt.h and 12 % of a frame of zbufrand.h with gcc, nothing in tetcast.h
$(EXAMPLES): OPT := $(STATIC)
$(filter $(B)/voxrt_% $(B)/zbufrand_%,$(EXAMPLES)): OPT := -O3 $(STATIC)
$(B)/voxrt_view $(B)/voxrt_convert: OPT := $(STATIC)
ifeq ($(origin CFLAGS),file)
$(filter $(B)/minimal_%,$(EXAMPLES)): OPT := -O1 $(STATIC)
endif
$(BENCHES): OPT := -O3
# tests are compiled for as long as they run: -Og is the sum's minimum; gcc takes a seventh of the time to look at
# indentation, which `make check` does once
TEST_OPT := $(STATIC)
ifeq ($(origin CFLAGS),file)
TEST_OPT += -Og -Wno-misleading-indentation
endif
$(TESTS) $(ALL_TESTS): OPT := $(TEST_OPT)
$(B)/tests/test_image: OPT := $(filter-out $(STATIC),$(TEST_OPT)) # declarations alone

COMPILE = @mkdir -p $(@D); echo "$(CC) $<"; \
	$(CC) $(CFLAGS) $(OPT) $(CPPFLAGS) -I. -MMD -MP -MF $@.d -MT $@ $(LDFLAGS) -o $@ $< $(LDLIBS)

$(B)/%: examples/%.c $(B)/.flags
	$(COMPILE)
$(B)/bench_%: bench/bench_%.c $(B)/.flags
	$(COMPILE)
$(B)/report: bench/report.c $(B)/.flags
	$(COMPILE)
$(B)/tests/%: tests/%.c $(B)/.flags
	$(COMPILE)
	@[ ! -f $@.exe ] || mv -f $@.exe $@ # how MinGW calls it
# tests of a header are one program with many names: the header takes longer to compile than its tests
LINK = @ln -f $< $@
$(filter $(B)/tests/test_voxrt_%,$(TESTS)): $(B)/tests/all_voxrt
	$(LINK)
$(filter $(B)/tests/test_zbufrand_%,$(TESTS)): $(B)/tests/all_zbufrand
	$(LINK)
$(filter $(B)/tests/test_tetcast_%,$(TESTS)): $(B)/tests/all_tetcast
	$(LINK)

# Rebuild everything when the compiler or the flags change.
FLAGS_NOW := $(CC) $(CFLAGS) $(CPPFLAGS) $(LDFLAGS) $(LDLIBS)
$(B)/.flags: FORCE
	@mkdir -p $(B); echo '$(FLAGS_NOW)' | cmp -s - $@ || echo '$(FLAGS_NOW)' > $@

-include $(wildcard $(B)/*.d $(B)/tests/*.d)

# --- pictures: the rules are in examples/demo.mk -------------------------------------------------

-include examples/demo.mk bench/peers/peers.mk examples/web/web.mk
demo: $(GALLERY)
	@echo "pictures are in $(G)/"

# --- tests ---------------------------------------------------------------------------------------

# long tests are shorter here; make test TEST_QUICK=0, or the group `long` of make check: all of them
TEST_QUICK ?= 1
test: $(ALL_TESTS) $(TESTS)
	@TEST_QUICK=$(TEST_QUICK) sh tests/run.sh $(TESTS)

# CHECKS: groups of tests/check.sh, empty: all
CHECKS ?=
check:
	@bash tests/check.sh $(CHECKS)

fuzz:
	@bash tests/check.sh fuzz

# an hour for each fuzzer; an hour of random use of all libraries whose memory must not grow
fuzz-long:
	@FUZZ_EACH=3600 bash tests/check.sh fuzz
soak:
	@SOAK_SECONDS=3600 bash tests/check.sh soak

SAN = -std=c99 -g -O1 -ffp-contract=off -fno-omit-frame-pointer -Wall -Wextra
test-asan:
	@TEST_QUICK=1 $(MAKE) --no-print-directory B=$(B)/asan CC=gcc \
	  CFLAGS='$(SAN) -fsanitize=address,undefined -fno-sanitize-recover=all' test
test-tsan:
	@TEST_QUICK=1 $(MAKE) --no-print-directory B=$(B)/tsan CC=clang CFLAGS='$(SAN) -fsanitize=thread' test
test-msan:
	@TEST_QUICK=1 $(MAKE) --no-print-directory B=$(B)/msan CC=clang \
	  CFLAGS='$(SAN) -fsanitize=memory -fsanitize-memory-track-origins' test

coverage:
	@TEST_QUICK=1 $(MAKE) --no-print-directory B=$(B)/cov CC=gcc CFLAGS='-std=c99 -g -O0 -ffp-contract=off --coverage' tests
	@bash tests/coverage.sh $(B)/cov $(HEADERS)
coverage-scalar: # the same without any vectors: what machines that have none run
	@TEST_QUICK=1 $(MAKE) --no-print-directory B=$(B)/cov-scalar CC=gcc \
	  CFLAGS='-std=c99 -g -O0 -ffp-contract=off --coverage -DVOXRT_NO_SIMD -DZBUFRAND_NO_SIMD -DTETCAST_NO_SIMD' tests
	@bash tests/coverage.sh $(B)/cov-scalar $(HEADERS)
refusals: # some ten minutes
	@bash tests/refusals.sh $(B)/refusals $(HEADERS)

# --- measuring: one program after the other, never in parallel -----------------------------------

BENCH_ARGS :=
bench-full: BENCH_ARGS := --full
bench bench-full: $(BENCHES) $(REPORT)
	@mkdir -p $(B)/bench
	@set -e; for p in $(BENCHES); do n=$${p##*/bench_}; echo "bench_$$n $(BENCH_ARGS)"; \
	  $$p $(BENCH_ARGS) > $(B)/bench/$$n.jsonl.part; mv $(B)/bench/$$n.jsonl.part $(B)/bench/$$n.jsonl; done
	@if [ -n "$(REPORT)" ]; then $(REPORT) $(B)/bench; fi

report: $(REPORT)
	@$(REPORT) $(B)/bench

# --- install -------------------------------------------------------------------------------------

install:
	@mkdir -p '$(DESTDIR)$(PREFIX)/include' '$(DESTDIR)$(PREFIX)/share/pkgconfig'
	@set -e; for h in $(HEADERS); do n=$${h%.h}; cp $$h '$(DESTDIR)$(PREFIX)/include/'; \
	  v=$$(for k in MAJOR MINOR PATCH; do sed -n "s/^# *define  *[A-Z]*_VERSION_$$k  *\([0-9]*\).*/\1/p" $$h; done | \
	    tr '\n' . | sed 's/\.$$//'); \
	  if [ -f $$n.pc.in ]; then sed -e 's|@INCLUDEDIR@|$(PREFIX)/include|g' -e "s|@VERSION@|$$v|g" $$n.pc.in \
	    > '$(DESTDIR)$(PREFIX)/share/pkgconfig/'$$n.pc; fi; echo "installed $$h $$v"; done

uninstall:
	@for h in $(HEADERS); do n=$${h%.h}; rm -f '$(DESTDIR)$(PREFIX)/include/'$$h \
	  '$(DESTDIR)$(PREFIX)/share/pkgconfig/'$$n.pc; done

clean:
	rm -rf $(B)

help:
	@echo "all         build every program into $(B)/ (examples, tests, benches: only those)"
	@echo "demo        pictures from generated scenes into $(G)/"
	@echo "test        build and run the tests (TEST=\"name part\" runs some, V=1 names each)"
	@echo "check       compile gate, sanitizers, fuzzing, other processors: hours; SHORT=1: half an hour"
	@echo "fuzz        fuzzing only (FUZZ_SECONDS=60)"
	@echo "test-asan test-tsan test-msan   tests under one sanitizer"
	@echo "coverage    lines of the headers that the tests reach; $(B)/cov/NAME.uncovered lists the others"
	@echo "coverage-scalar  the same without vector instructions"
	@echo "refusals    requests for memory in the headers that no test refuses"
	@echo "bench       short measurements and plots into $(B)/bench/; bench-full: all of them"
	@echo "bench-peers the same work by Embree, OpenVDB, llvmpipe and VTK where they are installed, one table (docs/peers.md)"
	@echo "web         a page with the three libraries in $(B)/web/ (needs emcc); web-test: the same page in Chromium"
	@echo "install     headers and pkg-config files below PREFIX=$(PREFIX) (DESTDIR= for packagers); uninstall"
	@echo "clean       remove $(B)/"
	@echo "CC=$(CC) CFLAGS=$(CFLAGS) B=$(B)"
