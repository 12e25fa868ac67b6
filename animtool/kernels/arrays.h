// Array types shared by the kernels. Every array is C-contiguous.
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <memory>

#ifdef __linux__
#include <sys/mman.h>
#include <unistd.h>
#endif

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace animtool {

namespace nb = nanobind;

template <typename T, std::size_t N>
using In = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

template <typename T, std::size_t N>
using Out = nb::ndarray<nb::numpy, T, nb::ndim<N>, nb::c_contig>;

// Asks for huge pages: for a large result that is written once, as numpy does too.
// Faults over small pages take several times as long as filling them.
inline void prefer_huge_pages([[maybe_unused]] void* data, [[maybe_unused]] std::size_t bytes) {
#ifdef MADV_HUGEPAGE
  constexpr std::size_t kLarge = std::size_t{1} << 22;
  if (bytes < kLarge) return;
  const auto page = static_cast<std::uintptr_t>(sysconf(_SC_PAGESIZE));
  const auto begin = reinterpret_cast<std::uintptr_t>(data);
  const std::uintptr_t first = (begin + page - 1) / page * page;
  // Only advice: where it is refused, the pages are small ones.
  madvise(reinterpret_cast<void*>(first), begin + bytes - first, MADV_HUGEPAGE);
#endif
}

// Storage for a result: filled without the GIL, then handed to numpy with it.
template <typename T>
class Buffer {
 public:
  explicit Buffer(std::size_t size) : data_(new T[size ? size : 1]) {
    prefer_huge_pages(data_.get(), size * sizeof(T));
  }

  T* get() { return data_.get(); }

  template <std::size_t N>
  Out<T, N> release(const std::size_t (&shape)[N]) {
    T* data = data_.release();
    nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
    return Out<T, N>(data, N, shape, owner);
  }

 private:
  std::unique_ptr<T[]> data_;
};

}  // namespace animtool
