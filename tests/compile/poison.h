/* What a program may have defined before it includes one of the headers: the macros of windows.h and others. */
#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#if defined(__x86_64__)
#  include <immintrin.h>
#endif
#define min(a, b) (((a) < (b)) ? (a) : (b))
#define max(a, b) (((a) > (b)) ? (a) : (b))
#define near
#define far
#define small char
#define interface struct
#define hyper long
#define I 1i
#define ERROR 0
#define DEBUG 1
#define TRUE 1
#define FALSE 0
#define PI 3
#define ABS(x) poison
#define MIN(a, b) poison
#define MAX(a, b) poison
#define CLAMP(x, a, b) poison
#define SWAP(a, b) poison
#define ALIGN(x) poison
#define alloc(x) poison
#define unix 1
#define linux 1
