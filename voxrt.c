#define VOXRT_IMPLEMENTATION
#include "voxrt.h"
