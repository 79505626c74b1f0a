// A library to preload (LD_PRELOAD) that delays the writes of a process below the folder
// HOID_SLOW_DISK while the file HOID_SLOW_WHILE exists, as a slow memory card does. Each delayed
// call appends a byte to that file.
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace {

constexpr useconds_t kWriteUs = 20'000, kSyncUs = 500'000;

void wait_if_slow(int file, useconds_t wait_us) {
  const char* folder = std::getenv("HOID_SLOW_DISK");
  const char* sign = std::getenv("HOID_SLOW_WHILE");
  if (folder == nullptr || sign == nullptr || access(sign, F_OK) != 0) return;
  char link[64], path[4096];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  const ssize_t length = readlink(link, path, sizeof path);
  const size_t own = std::strlen(folder);
  if (length <= static_cast<ssize_t>(own) || std::strncmp(path, folder, own) != 0) return;
  usleep(wait_us);
  const int counts = open(sign, O_WRONLY | O_APPEND | O_CLOEXEC);
  if (counts < 0) return;
  syscall(SYS_write, counts, ".", 1);
  close(counts);
}

template <typename Function>
Function next(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}

}  // namespace

extern "C" ssize_t write(int file, const void* data, size_t size) {
  static const auto real = next<ssize_t (*)(int, const void*, size_t)>("write");
  wait_if_slow(file, kWriteUs);
  return real(file, data, size);
}

extern "C" int fsync(int file) {
  static const auto real = next<int (*)(int)>("fsync");
  wait_if_slow(file, kSyncUs);
  return real(file);
}
