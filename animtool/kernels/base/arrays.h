// C-contiguous arrays of kernels: arguments and results.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

#include "base/memory.h"

namespace animtool {

// An argument array, kept alive by the caller while a kernel runs.
template <typename T, std::size_t N>
class View {
 public:
  View() = default;
  View(T* data, const std::array<std::size_t, N>& shape) : data_(data), shape_(shape) {}

  T* data() const { return data_; }
  std::size_t shape(std::size_t axis) const { return shape_[axis]; }
  const std::size_t* lengths() const { return shape_.data(); }
  std::size_t size() const {
    std::size_t count = 1;
    for (const std::size_t length : shape_) count *= length;
    return count;
  }
  static constexpr std::size_t ndim() { return N; }

 private:
  T* data_ = nullptr;
  std::array<std::size_t, N> shape_{};
};

template <typename T, std::size_t N>
using In = View<const T, N>;

// An array of the caller that a kernel fills.
template <typename T, std::size_t N>
using Filled = View<T, N>;

// A result array, uninitialised.
template <typename T, std::size_t N>
class Out {
 public:
  template <typename... Lengths>
    requires(sizeof...(Lengths) == N)
  explicit Out(Lengths... lengths)
      : shape_{static_cast<std::size_t>(lengths)...},
        data_(block<T>((static_cast<std::size_t>(lengths) * ...))) {}

  // Shrinks the array to a new shape; the first numbers stay.
  template <typename... Lengths>
  void truncate(Lengths... lengths) {
    shape_ = {static_cast<std::size_t>(lengths)...};
  }

  T* get() { return data_.get(); }
  const std::array<std::size_t, N>& shape() const { return shape_; }
  T* release() { return data_.release(); }

 private:
  std::array<std::size_t, N> shape_;
  Block<T> data_;
};

// Byte strings: an argument, owned by the caller, and a result.
struct Text {
  std::string_view bytes;
};
struct Bytes {
  std::string bytes;
};

}  // namespace animtool
