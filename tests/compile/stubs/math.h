#ifndef STUB_MATH_H
#define STUB_MATH_H
#define INFINITY (__builtin_inff())
#define NAN (__builtin_nanf(""))
#define HUGE_VALF (__builtin_huge_valf())
#define isnan(x) __builtin_isnan(x)
#define isinf(x) __builtin_isinf(x)
#define isfinite(x) __builtin_isfinite(x)
#define signbit(x) __builtin_signbit(x)
#ifdef __cplusplus
extern "C" {
#endif
float sqrtf(float);
float fmaf(float, float, float);
double sqrt(double);
float fabsf(float);
double fabs(double);
#ifdef __cplusplus
}
#endif
#endif
