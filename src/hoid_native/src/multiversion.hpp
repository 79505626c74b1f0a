// Functions compiled for newer processors as well: the loader takes what the machine at hand can run.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define MULTIVERSION(extension) __attribute__((target_clones(extension, "default")))
#else
#define MULTIVERSION(extension)
#endif

// What such a function calls is compiled like it only where it is inlined.
#define ALWAYS_INLINE __attribute__((always_inline)) inline
