# Programs that run the same work on well-known systems. `make peers` builds those whose system is installed, `make bench-peers`
# runs them with one and with two threads and writes $(B)/bench/peers.md and peers.jsonl: some twenty minutes.
#   Debian: apt-get install libembree-dev libopenvdb-dev libnanovdb-dev libosmesa6-dev libvtk9-dev xvfb xauth

PEER_CXXFLAGS ?= -std=c++17 -O3 -march=native -ffp-contract=off -Wall -Wextra
PEER_THREADS  ?= 1 2
PEER_ARGS     ?=

# where the headers of each system are; empty: not installed
peer_find    = $(firstword $(wildcard $(addsuffix /$(1),/usr/include /usr/local/include)))
PEER_EMBREE  := $(call peer_find,embree3/rtcore.h)
PEER_OPENVDB := $(call peer_find,openvdb/openvdb.h)
PEER_NANOVDB := $(call peer_find,nanovdb/NanoVDB.h)
PEER_OSMESA  := $(call peer_find,GL/osmesa.h)
PEER_VTK     := $(patsubst %/vtkVersion.h,%,$(call peer_find,vtk-9*/vtkVersion.h))
PEER_VTK_V   := $(patsubst vtk-%,%,$(notdir $(PEER_VTK)))
PEER_XVFB    := $(shell command -v xvfb-run 2>/dev/null)

# name of a program, what it needs, its package
PEER_PROGRAMS := embree_voxrt embree_zbufrand vdb_voxrt osmesa_zbufrand vtk_tetcast
PEER_NEEDS_embree_voxrt    := $(PEER_EMBREE)
PEER_NEEDS_embree_zbufrand := $(PEER_EMBREE)
PEER_NEEDS_vdb_voxrt       := $(PEER_OPENVDB)
PEER_NEEDS_osmesa_zbufrand := $(PEER_OSMESA)
PEER_NEEDS_vtk_tetcast     := $(PEER_VTK)
PEER_DEB_embree_voxrt    := Embree is not installed (Debian: libembree-dev)
PEER_DEB_embree_zbufrand := $(PEER_DEB_embree_voxrt)
PEER_DEB_vdb_voxrt       := OpenVDB is not installed (Debian: libopenvdb-dev libnanovdb-dev)
PEER_DEB_osmesa_zbufrand := llvmpipe is not installed (Debian: libosmesa6-dev)
PEER_DEB_vtk_tetcast     := VTK is not installed (Debian: libvtk9-dev)

PEER_VTK_MODULES := CommonCore CommonDataModel CommonExecutionModel CommonTransforms CommonMath CommonSystem CommonMisc \
  FiltersCore FiltersGeneral RenderingCore RenderingOpenGL2 RenderingVolume RenderingVolumeOpenGL2
PEER_LIBS_embree_voxrt    := -lembree3
PEER_LIBS_embree_zbufrand := -lembree3
PEER_LIBS_vdb_voxrt       := -lopenvdb -ltbb -lImath-3_1
PEER_LIBS_osmesa_zbufrand := -lOSMesa
PEER_LIBS_vtk_tetcast     := $(foreach m,$(PEER_VTK_MODULES),-lvtk$(m)-$(PEER_VTK_V))
# NanoVDB's own headers are inlined into ours, where gcc says that they may not initialise something
PEER_FLAGS_vdb_voxrt      := -DNDEBUG -DPEER_NANOVDB=$(if $(PEER_NANOVDB),1 -DNANOVDB_USE_OPENVDB -Wno-maybe-uninitialized,0)
PEER_FLAGS_vtk_tetcast    := -isystem $(PEER_VTK)

PEERS := $(foreach p,$(PEER_PROGRAMS),$(if $(PEER_NEEDS_$(p)),$(B)/peer_$(p)))

.PHONY: peers bench-peers
peers: $(PEERS)
	@if [ -z '$(PEERS)' ]; then echo "peers: nothing to build (see bench/peers/peers.mk for what to install)"; fi

# Rebuild the programs when their compiler or flags change; they print what is in this file.
$(B)/.peer_flags: FORCE
	@mkdir -p $(B); echo '$(CXX) $(PEER_CXXFLAGS)' | cmp -s - $@ || echo '$(CXX) $(PEER_CXXFLAGS)' > $@

$(PEERS): $(B)/peer_%: bench/peers/%.cpp $(B)/.peer_flags
	@mkdir -p $(@D); echo "$(CXX) $<"; $(CXX) $(PEER_CXXFLAGS) $(PEER_FLAGS_$*) -DBENCH_FLAGS_FILE='".peer_flags"' -I. -MMD -MP -MF $@.d -MT $@ -o $@ $< \
	  $(PEER_LIBS_$*) -lm -lpthread

$(B)/peer_table: bench/peers/table.c $(B)/.flags
	$(COMPILE)

# Windows of VTK need a screen: one in memory where there is none. LP_NUM_THREADS: of llvmpipe, which draws for VTK, too.
bench-peers: $(PEERS) $(B)/peer_table
	@mkdir -p $(B)/bench/peers; rm -f $(B)/bench/peers/*
	@for t in $(PEER_THREADS); do for p in $(notdir $(PEERS)); do \
	  out=$(B)/bench/peers/$$t-$$p.jsonl; screen=; \
	  if [ $$p = peer_vtk_tetcast ] && [ -z "$$DISPLAY" ]; then screen='$(if $(PEER_XVFB),xvfb-run -a)'; fi; \
	  echo "$$p --threads $$t $(PEER_ARGS)"; \
	  LP_NUM_THREADS=$$((t - 1)) $$screen $(B)/$$p --threads $$t $(PEER_ARGS) > $$out || \
	    printf '{"bench":"peers.%s","skipped":"%s failed with %s threads"}\n' "$${p#peer_}" $$p $$t >> $$out; done; done
	@$(foreach p,$(PEER_PROGRAMS),$(if $(PEER_NEEDS_$(p)),,printf '{"bench":"peers.%s","skipped":"%s"}\n' \
	  '$(p)' '$(PEER_DEB_$(p))' > $(B)/bench/peers/0-$(p).jsonl;)) true
	@cat $(B)/bench/peers/*.jsonl > $(B)/bench/peers.jsonl
	@$(B)/peer_table $(B)/bench/peers.jsonl > $(B)/bench/peers.md.part; mv $(B)/bench/peers.md.part $(B)/bench/peers.md
	@cat $(B)/bench/peers.md
