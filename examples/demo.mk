# Pictures of `make demo`: generated scenes become voxel files in $(G)/vox, those become pictures in $(G). Rules may run
# at the same time (make -j2). A picture of voxrt_render has one line: its voxel file, and one: its options.

# --- voxel files: the name is the scene, `detail` how fine its mesh is -------------------------------------------

VOX := $(G)/vox
VOXRT_SCENES := $(addprefix $(VOX)/,sphere.vox gyroid.vox terrain.vox menger.vox cornell.vox pillars.vox blob.vox balls.vox)

$(VOX)/sphere.vox: detail = --detail 256
$(VOX)/gyroid.vox: detail = --detail 96
$(VOX)/terrain.vox: detail = --detail 512
$(VOX)/menger.vox: detail = --detail 5
$(VOX)/menger.vox $(VOX)/cornell.vox: res = 486
$(VOX)/pillars.vox: res = 2048
$(VOX)/balls.vox: res = 1024
$(VOX)/%: res = 1024

$(VOXRT_SCENES): $(VOX)/%.vox: $(B)/voxrt_convert
	@mkdir -p $(@D); echo "$@"; $(B)/voxrt_convert --scene $* $@ --quiet --res $(res) $(detail)

# The torus as the thesis of 2009 made it, and as it is made now.
$(VOX)/torus-2009.vox: $(B)/voxrt_convert
	@mkdir -p $(@D); echo "$@"; $(B)/voxrt_convert --scene torus --detail 128 $@ --quiet --res 512 \
	  --separating thesis --palette-method thesis --lod majority --format v4
$(VOX)/torus.vox: $(B)/voxrt_convert
	@mkdir -p $(@D); echo "$@"; $(B)/voxrt_convert --scene torus --detail 128 $@ --quiet --res 512

$(VOX)/torus-planes.vox: $(B)/voxrt_convert
	@mkdir -p $(@D); echo "$@"; $(B)/voxrt_convert --scene torus --detail 128 $@ --quiet --res 64 --planes

# A ball that was filled, painted and cut open.
$(VOX)/planet.vox: $(B)/voxrt_convert examples/planet.txt
	@mkdir -p $(@D); echo "$@"; $(B)/voxrt_convert --scene sphere --detail 128 $@ --quiet --res 256 --fill --edit examples/planet.txt

# --- pictures ----------------------------------------------------------------------------------------------------

SKY := --background 0.55,0.66,0.8
LAND := $(SKY) --one-sided --eye 1.5,0.75,1.9 --at 0,0.25,-0.2 --fov 45

$(G)/voxrt_sphere.png: $(VOX)/sphere.vox
$(G)/voxrt_sphere.png: options = --shadows --aa 8 --light dir:-1,0.9,0.3 $(SKY) --eye 1.3,0.9,2.1 --at 0,0,0 --fov 46

$(G)/voxrt_gyroid.png: $(VOX)/gyroid.vox
$(G)/voxrt_gyroid.png: options = --shadows --aa 8 $(SKY) --eye 1.3,0.95,2.1 --at 0,-0.02,0 --fov 44

$(G)/voxrt_terrain.png: $(VOX)/terrain.vox
$(G)/voxrt_terrain.png: options = --shadows --aa 8 $(LAND)

$(G)/voxrt_terrain_heat.png: $(VOX)/terrain.vox
$(G)/voxrt_terrain_heat.png: options = --heat outer --heat-max 40 $(LAND)

$(G)/voxrt_terrain_lod.png: $(VOX)/terrain.vox
$(G)/voxrt_terrain_lod.png: options = --shadows --aa 8 --lod-split 7 $(LAND)

$(G)/voxrt_terrain_split.png: $(VOX)/terrain.vox
$(G)/voxrt_terrain_split.png: options = --shadows --aa 8 --split $(LAND)

$(G)/voxrt_menger.png: $(VOX)/menger.vox
$(G)/voxrt_menger.png: options = --shadows --aa 8 --one-sided $(SKY) --eye 0.15,0.1,0.95 --at -0.1,-0.15,-1 --fov 75

$(G)/voxrt_cornell.png: $(VOX)/cornell.vox
$(G)/voxrt_cornell.png: options = --size 480x480 --shadows --aa 4 --one-sided --eye 2.78,2.73,8 --at 2.78,2.73,-2.8 --fov 37.7 \
	--light 2.78,2.73,8:0.1,0.1,0.1 $(foreach x,2.3 2.62 2.94 3.26,\
	$(foreach z,-2.4 -2.8 -3.2,--light $x,5.2,$z:0.065,0.06,0.053))

$(G)/voxrt_pillars.png: $(VOX)/pillars.vox
$(G)/voxrt_pillars.png: options = --shadows --aa 4 --one-sided --eye -0.2,2.2,16 --at -1,3.2,0 --fov 62 \
	--light 0,4,12:0.5,0.4,0.3 --light -4,5,2:0.5,0.42,0.35 --light 4,3,-8:0.3,0.35,0.5

$(G)/voxrt_blob.png: $(VOX)/blob.vox
$(G)/voxrt_blob.png: options = --shadows --aa 8 $(SKY) --eye 1.3,0.85,2.1 --at 0,-0.08,0 --fov 58

$(G)/voxrt_blob_cubes.png: $(VOX)/blob.vox
$(G)/voxrt_blob_cubes.png: options = --shadows --aa 8 $(SKY) --lod 6 --normals face --eye 1.3,0.85,2.1 --at 0,-0.08,0 --fov 58

$(G)/voxrt_planet.png: $(VOX)/planet.vox
$(G)/voxrt_planet.png: options = --shadows --aa 4 $(SKY) --eye 1.5,1.2,2.1 --at 0,-0.02,0 --fov 44 --light dir:0.3,0.9,0.8

$(G)/voxrt_balls.png: $(VOX)/balls.vox
$(G)/voxrt_balls.png: options = --size 656x400 --shadows --aa 4 $(SKY) --eye 0.5,1.75,4.4 --at -0.1,0.76,-0.2 --fov 36 \
	--light 0.5,1.75,-0.8:0.6,0.5,0.36 --light dir:-1,1.2,0.6:0.5,0.5,0.5

# A version 4 file has no placement: one voxel is a unit. Both see the same.
$(G)/voxrt_planes.png $(G)/voxrt_planes_off.png: $(VOX)/torus-planes.vox
$(G)/voxrt_planes.png: options = --shadows --aa 8 $(SKY) --size 656x640 --eye 1.1,1.3,1.9 --at 0.35,-0.05,0.25 --fov 38
$(G)/voxrt_planes_off.png: options = --cubes --shadows --aa 8 $(SKY) --size 656x640 --eye 1.1,1.3,1.9 --at 0.35,-0.05,0.25 --fov 38

$(G)/voxrt_million.png: $(VOX)/planet.vox
$(G)/voxrt_million.png: options = --scatter 1000000 --shadows --aa 1 $(SKY) --eye 0,14,40 --at 0,-1,-20 --fov 42 --light dir:0.5,0.8,0.6

$(G)/voxrt_torus_2009.png: $(VOX)/torus-2009.vox
$(G)/voxrt_torus_2009.png: options = --path thesis --compose thesis --shadows --lod off $(SKY) \
	--eye 484,475,740 --at 256,245,256 --fov 46

$(G)/voxrt_torus.png: $(VOX)/torus.vox
$(G)/voxrt_torus.png: options = --shadows --aa 8 $(SKY) --eye 1.25,1.2,2.65 --at 0,-0.06,0 --fov 46

$(G)/voxrt_aa1.png: $(VOX)/menger.vox
$(G)/voxrt_aa1.png: options = --size 328x160 --lod off --shadows $(SKY) --eye 3,2.5,4 --at 0,0,0 --fov 40

$(G)/voxrt_aa64.png: $(VOX)/menger.vox
$(G)/voxrt_aa64.png: options = --size 328x160 --aa 64 --shadows $(SKY) --eye 3,2.5,4 --at 0,0,0 --fov 40

VOXRT_PICTURES := $(addprefix $(G)/voxrt_,sphere.png gyroid.png terrain.png terrain_heat.png terrain_lod.png \
	terrain_split.png menger.png cornell.png pillars.png blob.png blob_cubes.png torus_2009.png torus.png planet.png planes.png planes_off.png balls.png million.png aa1.png aa64.png)

$(VOXRT_PICTURES): $(B)/voxrt_render
	@mkdir -p $(@D); echo "$@"; $(B)/voxrt_render $(filter %.vox,$^) --out $@ --quiet $(options)

$(G)/voxrt_minimal.png: $(B)/minimal_voxrt
	@mkdir -p $(@D); echo "$@"; $(B)/minimal_voxrt $@

GALLERY += $(VOXRT_PICTURES) $(G)/voxrt_minimal.png

# --- zbufrand: scenes of up to 6.8 * 10^11 triangles ---------------------------------------------------------------

$(G)/zbufrand_forest_1.png: options = --scene forest --view 1 --aa 2
$(G)/zbufrand_forest_0.png: options = --scene forest --eye 0,12,7950 --at 0,4,7925 --fov 45 --aa 2
$(G)/zbufrand_forest_2.png: options = --scene forest --view 2 --aa 2
$(G)/zbufrand_forest_3.png: options = --scene forest --view 3 --aa 2
$(G)/zbufrand_forest_4.png: options = --scene forest --view 4 --aa 3
$(G)/zbufrand_city.png: options = --scene city --view 2 --aa 2
$(G)/zbufrand_chess.png: options = --scene chess --eye 0,0.016,0.995 --at 0,-0.004,0.9 --aa 4
$(G)/zbufrand_landscape.png: options = --scene landscape --view 3

ZBUFRAND_PICTURES := $(addprefix $(G)/zbufrand_,forest_0.png forest_1.png forest_2.png forest_3.png forest_4.png city.png chess.png \
	landscape.png)

$(ZBUFRAND_PICTURES): $(B)/zbufrand_render
	@mkdir -p $(@D); echo "$@"; $(B)/zbufrand_render $(options) --size 960x720 --out $@ --quiet

$(G)/zbufrand_minimal.png: $(B)/minimal_zbufrand
	@mkdir -p $(@D); echo "$@"; $(B)/minimal_zbufrand $@

# --- voxrt: light that bounces -------------------------------------------------------------------------------------

$(G)/voxrt_gi_cornell.png: options = --scene cornell --size 400x400 --res 512 --rays 64
$(G)/voxrt_gi_atrium.png: options = --scene atrium --size 360x240 --res 1024
$(G)/voxrt_gi_openness.png: options = --scene atrium --size 432x288 --res 1024 --method ao --radius 3

$(G)/voxrt_gi_still_life.png: options = --scene examples/still_life.txt --size 360x240 --grid 128 --shadow-filter 2
$(G)/voxrt_gi_cubes.png: options = --scene cornell --size 360x360 --res 256 --grid 64 --depth-cells 64 --aa 1 --view cubes
$(G)/voxrt_gi_virtual_lights.png: options = --scene cornell --size 360x360 --res 256 --grid 128 --aa 1 --view lights
$(G)/voxrt_gi_steps.png: options = --scene cornell --size 360x360 --res 64 --grid 64 --depth-cells 64 --aa 1 --view steps --pixel 135,225
$(G)/voxrt_gi_lookup.png: options = --scene atrium --size 360x240 --res 256 --grid 128 --aa 1 --method vpl --view lookup

GI_PICTURES := $(addprefix $(G)/voxrt_gi_,cornell.png atrium.png openness.png still_life.png cubes.png virtual_lights.png lookup.png steps.png)

$(GI_PICTURES): $(B)/voxrt_gi
	@mkdir -p $(@D); echo "$@"; $(B)/voxrt_gi --rays 16 --bounces 2 $(options) --out $@ --quiet

# --- tetcast: fields on tetrahedra ---------------------------------------------------------------------------------

NIGHT := --background 0.012,0.013,0.018
$(G)/tetcast_lattice.png: options = --scene lattice --tf smooth
$(G)/tetcast_ball.png: options = --scene ball --tf shells
$(G)/tetcast_ring.png: options = --scene ring
$(G)/tetcast_bow.png: options = --scene bow
$(G)/tetcast_fins.png: options = --scene fins --tf hot --eye 3.3,0.35,0.25 --at 0,0,-0.05 --fov 42
$(G)/tetcast_bow_shock.png: options = --scene bow --tf hot --iso 0.6 --iso-opacity 0.4 --model mixed --smooth \
	--eye -3.2,1.6,1.9 --at 0,-0.1,0 --fov 40
$(G)/tetcast_foam.png: options = --scene ball --detail 16 --tf shells --extinction 4 --method foam
$(G)/tetcast_maximum.png: options = --scene ring --tf hot --model maximum
$(G)/tetcast_xray.png: options = --scene lattice --tf xray --model absorption --background 1,1,1
$(G)/tetcast_iso.png: options = --scene ball --iso 0.2 --smooth
$(G)/tetcast_mixed.png: options = --scene lattice --iso 0.75 --iso 0.25 --iso-opacity 0.7 --smooth

TETCAST_PICTURES := $(addprefix $(G)/tetcast_,lattice.png ball.png ring.png bow.png bow_shock.png fins.png foam.png maximum.png xray.png iso.png \
	mixed.png)

$(TETCAST_PICTURES): $(B)/tetcast_render
	@mkdir -p $(@D); echo "$@"; $(B)/tetcast_render $(NIGHT) $(options) --out $@ --quiet

$(G)/tetcast_minimal.png: $(B)/minimal_tetcast
	@mkdir -p $(@D); echo "$@"; $(B)/minimal_tetcast $@

# A generated flow and a generated volume as radial basis functions.
RBF := $(G)/rbf
$(RBF)/%.rbf: $(B)/tetcast_rbf
	@mkdir -p $(@D); echo "$@"; $(B)/tetcast_rbf fit $* $@ --quiet --max-error 0.05 $(detail)
$(RBF)/ball.rbf: detail = --detail 24
$(RBF)/tornado.rbf: detail = --between

$(G)/tetcast_rbf_tornado.png: $(RBF)/tornado.rbf
	@mkdir -p $(@D); echo "$@"; $(B)/tetcast_rbf render $< --out $@ --quiet --channel vorticity --samples 60 --size 480x480
$(G)/tetcast_rbf_traces.png: $(RBF)/tornado.rbf
	@mkdir -p $(@D); echo "$@"; $(B)/tetcast_rbf trace $< --out $@ --quiet --seeds 110
$(G)/tetcast_rbf_ball.png: $(RBF)/ball.rbf
	@mkdir -p $(@D); echo "$@"; $(B)/tetcast_rbf render $< $(NIGHT) --inside ball --shader lit --tf shells --samples 500 --size 640x640 --out $@ --quiet

GALLERY += $(G)/tetcast_rbf_tornado.png $(G)/tetcast_rbf_traces.png $(G)/tetcast_rbf_ball.png

# Bricks: as fine as an error of 4 % asks for; and finest at one place, coarser away from it.
$(G)/tetcast_bricks.png: $(B)/tetcast_bricks
	@mkdir -p $(G)/bricks; echo "$@"; $(B)/tetcast_bricks resample --scene fins $(G)/bricks/fins.brk --max-error 0.04 --longest-end 257 --quiet && \
	  $(B)/tetcast_bricks render $(G)/bricks/fins.brk $(NIGHT) --tf hot --out $@ --quiet
$(G)/tetcast_bricks_lod.png: $(B)/tetcast_bricks
	@mkdir -p $(G)/bricks; echo "$@"; $(B)/tetcast_bricks resample --scene ball $(G)/bricks/ball.brk --max-error 0 --longest 97 --brick 8 --quiet && \
	  $(B)/tetcast_bricks render $(G)/bricks/ball.brk $(NIGHT) --iso 0.2 --focus 0.6,0.3,0.6 --radius 0.5 --out $@ --quiet

# The flow around a blunt body as tetrahedra, bricks and functions.
$(RBF)/bow.rbf: detail = --detail 24 --mean-error 0.01
$(G)/tetcast_three.png: $(RBF)/bow.rbf $(B)/tetcast_bricks
	@mkdir -p $(G)/bricks; echo "$@"; $(B)/tetcast_bricks resample --scene bow --detail 24 $(G)/bricks/bow.brk --max-error 0.02 --longest-end 257 --quiet && \
	  $(B)/tetcast_bricks render $(G)/bricks/bow.brk $(NIGHT) --detail 24 --tf hot --reference bow --functions $< --size 400x400 --eye -3.2,1.6,1.9 --at 0,-0.05,0 --fov 42 \
	  --out $@ --quiet
GALLERY += $(G)/tetcast_three.png

GALLERY += $(GI_PICTURES) $(ZBUFRAND_PICTURES) $(G)/zbufrand_minimal.png $(TETCAST_PICTURES) $(G)/tetcast_minimal.png \
	$(G)/tetcast_bricks.png $(G)/tetcast_bricks_lod.png

# Optional: needs MPI (Debian: libopenmpi-dev). make build/tetcast_mpi
$(B)/tetcast_mpi: examples/mpi/tetcast_mpi.c tetcast.h
	@mkdir -p $(@D); echo "mpicc $<"; mpicc -std=c99 -O2 -ffp-contract=off -Wall -Wextra -DTETCAST_STATIC -I. -Iexamples -o $@ $< -lm -lpthread
