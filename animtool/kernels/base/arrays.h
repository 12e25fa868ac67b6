// Array types shared by the kernels. Every array is C-contiguous.
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <memory>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "base/memory.h"

namespace animtool {

namespace nb = nanobind;

template <typename T, std::size_t N>
using In = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

// An array of the caller's that a kernel fills.
template <typename T, std::size_t N>
using Filled = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

template <typename T, std::size_t N>
using Out = nb::ndarray<nb::numpy, T, nb::ndim<N>, nb::c_contig>;

// Storage for a result: filled without the GIL, then handed to numpy with it.
template <typename T>
class Buffer {
 public:
  explicit Buffer(std::size_t size) : data_(block<T>(size)) {}

  T* get() { return data_.get(); }

  template <std::size_t N>
  Out<T, N> release(const std::size_t (&shape)[N]) {
    T* data = data_.release();
    nb::capsule owner(data, [](void* p) noexcept { Freed()(p); });
    return Out<T, N>(data, N, shape, owner);
  }

 private:
  Block<T> data_;
};

}  // namespace animtool
