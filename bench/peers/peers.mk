# Programs that run the same work on well-known systems. `make peers` builds those whose system is installed.

PEER_CXXFLAGS ?= -std=c++17 -O3 -march=native -ffp-contract=off
PEER_EMBREE   := $(wildcard /usr/include/embree3/rtcore.h /usr/local/include/embree3/rtcore.h)
PEERS         := $(if $(PEER_EMBREE),$(B)/peer_embree_voxrt)

.PHONY: peers
peers: $(PEERS)
	@if [ -z '$(PEERS)' ]; then echo "peers: nothing to build (Debian: apt-get install libembree-dev)"; fi

$(B)/peer_embree_voxrt: bench/peers/embree_voxrt.cpp $(B)/.flags
	@mkdir -p $(@D); echo "$(CXX) $<"; $(CXX) $(PEER_CXXFLAGS) -I. -MMD -MP -MF $@.d -MT $@ -o $@ $< -lembree3 -lpthread
