// Marks which code of the kernels runs: a byte for each block, by its address, in the file
// that KERNEL_HITS names, which a test's processes share.
#include <cstdint>
#include <cstdlib>

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

namespace {

unsigned char* table = nullptr;
std::uintptr_t base = 0, size = 0;

__attribute__((constructor)) void open_table() {
  const char* path = std::getenv("KERNEL_HITS");
  const int file = path ? open(path, O_RDWR) : -1;
  struct stat status;
  Dl_info info;
  if (file < 0 || fstat(file, &status) || !dladdr(&table, &info)) return;
  void* shared = mmap(nullptr, status.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  close(file);
  if (shared == MAP_FAILED) return;
  base = reinterpret_cast<std::uintptr_t>(info.dli_fbase);
  size = status.st_size;
  table = static_cast<unsigned char*>(shared);
}

}  // namespace

extern "C" void __sanitizer_cov_trace_pc() {
  const auto at = reinterpret_cast<std::uintptr_t>(__builtin_return_address(0)) - base;
  if (table && at < size) table[at] = 1;
}
