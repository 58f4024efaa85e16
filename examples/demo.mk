# Pictures of `make demo`: one rule each, and its name in GALLERY. Rules may run at the same time (make -j2).
#
# GALLERY += $(G)/voxrt_bunny.png
# $(G)/voxrt_bunny.png: $(B)/minimal_voxrt
# 	@mkdir -p $(@D); echo "$@"; $(B)/minimal_voxrt $@
