# The three libraries in a page. Nothing else depends on it: `make web` needs Emscripten, `make web-test` Chromium, too.
# `node examples/web/serve.js build/web` shows it.

WEB   := $(B)/web
EMCC  ?= emcc
WEB_C := examples/web/web.c
WEB_FUNCTIONS := _malloc,_web_start,_web_open,_web_text,_web_quick,_web_refine,_web_error,_web_pixels
WEB_FLAGS := -std=c99 -O3 -ffp-contract=off -DNDEBUG $(STATIC) --no-entry -s MODULARIZE=1 -s EXPORT_NAME=createDemo -s ENVIRONMENT=worker \
  -s FILESYSTEM=0 -s IMPORTED_MEMORY=1 -s ALLOW_MEMORY_GROWTH=1 -s INITIAL_MEMORY=64MB -s MAXIMUM_MEMORY=1GB \
  -s EXPORTED_FUNCTIONS=$(WEB_FUNCTIONS)
# what a browser without SIMD and threads runs, and one with both
WEB_ONE  :=
WEB_MANY := -msimd128 -pthread -s PTHREAD_POOL_SIZE=Module.poolSize -Wno-pthreads-mem-growth
WEB_PAGE := $(addprefix $(WEB)/,index.html page.js worker.js)

.PHONY: web web-test
ifeq ($(shell command -v $(EMCC) 2>/dev/null),)
web web-test:
	@echo "$@: skipped, there is no $(EMCC) (Emscripten)"
else
web: $(WEB)/demo.js $(WEB)/demo-threads.js $(WEB_PAGE)
	@echo "the page is in $(WEB)/; node examples/web/serve.js $(WEB) shows it"
web-test: web
	@node examples/web/test.js $(WEB)
endif

# where Debian keeps what emcc needs of node's modules
$(WEB)/demo.js $(WEB)/demo-threads.js: export NODE_PATH := /usr/share/nodejs
$(WEB)/demo.js: more = $(WEB_ONE)
$(WEB)/demo-threads.js: more = $(WEB_MANY)
$(WEB)/demo.js $(WEB)/demo-threads.js: $(WEB_C) $(HEADERS) $(wildcard examples/support/*.h) examples/web/web.mk
	@mkdir -p $(@D); echo "$(EMCC) $@"; $(EMCC) $(WEB_FLAGS) $(more) -o $@ $<
$(WEB_PAGE): $(WEB)/%: examples/web/%
	@mkdir -p $(@D); cp $< $@
