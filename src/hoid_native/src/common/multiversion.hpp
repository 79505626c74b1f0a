// Compiles a function twice: for any x86-64 processor and for those with an extension such as
// AVX2. When the module is loaded, the version for the present processor is chosen. With
// HOID_ONE_VERSION, and with clang or for another processor, only one version is compiled.
// test_dispatch.py checks that both return the same bits.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(HOID_ONE_VERSION)
#define MULTIVERSION(extension) __attribute__((target_clones(extension, "default")))
#else
#define MULTIVERSION(extension)
#endif

// A function called by a MULTIVERSION function gets the extension only if it is inlined.
#define ALWAYS_INLINE __attribute__((always_inline)) inline
