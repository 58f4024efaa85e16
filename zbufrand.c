#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
