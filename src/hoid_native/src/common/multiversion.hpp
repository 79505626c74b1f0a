// Functions compiled for newer processors as well: the loader takes what the machine at hand can
// run. With HOID_ONE_VERSION there is only the one for every processor, which tests compare with
// the others.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(HOID_ONE_VERSION)
#define MULTIVERSION(extension) __attribute__((target_clones(extension, "default")))
#else
#define MULTIVERSION(extension)
#endif

// What such a function calls is compiled like it only where it is inlined.
#define ALWAYS_INLINE __attribute__((always_inline)) inline
