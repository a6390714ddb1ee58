/* Whether this machine has the instructions that the library was compiled for; see library.py. It
 * is compiled for the least machine of its kind, so that it runs where the rest would not. */
#include "kernel.h"

/* What the library was compiled for and of (setup.py): text, which any machine can tell. */
#ifndef DP_BUILD
#define DP_BUILD "unknown"
#endif
#if defined(__clang__)
#define COMPILER "clang "
#elif defined(__GNUC__)
#define COMPILER "gcc "
#else
#define COMPILER "cc "
#endif
#ifdef __VERSION__
#define COMPILER_VERSION __VERSION__
#else
#define COMPILER_VERSION ""
#endif
#if defined(__x86_64__) && defined(__GNUC__)
__attribute__((target("arch=x86-64")))
#endif
const char* dp_build(void) {
  return DP_BUILD ", " COMPILER COMPILER_VERSION;
}

#if defined(__x86_64__) && defined(__GNUC__)
__attribute__((target("arch=x86-64"), noinline)) static const char* missing(void) {
  __builtin_cpu_init();
#define NEEDS(name) \
  if (!__builtin_cpu_supports(name)) return name;
#ifdef __SSE4_2__
  NEEDS("sse4.2")
#endif
#ifdef __AVX__
  NEEDS("avx")
#endif
#ifdef __AVX2__
  NEEDS("avx2")
#endif
#ifdef __FMA__
  NEEDS("fma")
#endif
#ifdef __BMI__
  NEEDS("bmi")
#endif
#ifdef __BMI2__
  NEEDS("bmi2")
#endif
#ifdef __AVX512F__
  NEEDS("avx512f")
#endif
#ifdef __AVX512DQ__
  NEEDS("avx512dq")
#endif
#ifdef __AVX512BW__
  NEEDS("avx512bw")
#endif
#ifdef __AVX512VL__
  NEEDS("avx512vl")
#endif
#ifdef __AVX512VNNI__
  NEEDS("avx512vnni")
#endif
  return "";
}
__attribute__((target("arch=x86-64"))) const char* dp_missing_instructions(void) {
  return missing();
}
#else
const char* dp_missing_instructions(void) { return ""; }
#endif
