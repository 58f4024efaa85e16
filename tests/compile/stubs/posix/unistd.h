#ifndef STUB_UNISTD_H
#define STUB_UNISTD_H
#ifdef __cplusplus
extern "C" {
#endif
#define _SC_NPROCESSORS_ONLN 84
long sysconf(int);
#ifdef __cplusplus
}
#endif
#endif
