// Uninitialised memory for many numbers.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>
#include <type_traits>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace animtool {

// Frees memory from malloc.
struct FreeDeleter {
  void operator()(void* memory) const noexcept { std::free(memory); }
};
template <typename T>
using Block = std::unique_ptr<T[], FreeDeleter>;

// Allocates uninitialised memory. Large blocks use huge pages if the system has them: the first
// access to a small page takes as long as the work on its contents.
template <typename T>
Block<T> block(std::size_t count) {
  static_assert(std::is_trivially_copyable_v<T>);
  const std::size_t bytes = std::max<std::size_t>(count, 1) * sizeof(T);
  void* memory = nullptr;
#if defined(__linux__)
  constexpr std::size_t HUGE_PAGE_SIZE = std::size_t{1} << 21;
  if (bytes >= 2 * HUGE_PAGE_SIZE && !posix_memalign(&memory, HUGE_PAGE_SIZE, bytes))
    madvise(memory, bytes / HUGE_PAGE_SIZE * HUGE_PAGE_SIZE, MADV_HUGEPAGE);
#endif
  if (!memory) memory = std::malloc(bytes);
  if (!memory) throw std::bad_alloc();
  return Block<T>(static_cast<T*>(memory));
}

}  // namespace animtool
