#ifndef STUB_INTRIN_H
#define STUB_INTRIN_H
#ifdef __cplusplus
extern "C" {
#endif
long _InterlockedExchangeAdd(long volatile *, long);
long _InterlockedCompareExchange(long volatile *, long, long);
long _InterlockedExchange(long volatile *, long);
long _InterlockedOr(long volatile *, long);
__int64 _InterlockedExchangeAdd64(__int64 volatile *, __int64);
__int64 _InterlockedCompareExchange64(__int64 volatile *, __int64, __int64);
void _ReadWriteBarrier(void);
unsigned char _BitScanForward(unsigned long *, unsigned long);
unsigned char _BitScanReverse(unsigned long *, unsigned long);
unsigned char _BitScanForward64(unsigned long *, unsigned __int64);
unsigned char _BitScanReverse64(unsigned long *, unsigned __int64);
#if defined(_M_X64)
void __cpuid(int *, int);
void __cpuidex(int *, int, int);
#endif
#ifdef __cplusplus
}
#endif
#endif
