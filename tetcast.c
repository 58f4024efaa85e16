#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
