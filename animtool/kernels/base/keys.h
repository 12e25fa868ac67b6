// Points sorted by the keys of their cells.
#pragma once

#include <algorithm>
#include <cstdint>

#include "base/memory.h"

namespace animtool {

// Keys of cells and indices of points, `count` of them.
struct SortedKeys {
  explicit SortedKeys(std::size_t capacity)
      : keys(block<std::uint64_t>(capacity)), indices(block<std::int32_t>(capacity)) {}

  Block<std::uint64_t> keys;
  Block<std::int32_t> indices;
  std::size_t count = 0;
};

// Sorts by key: a stable radix sort, lowest bits first. Static, because sources that are built for
// different processors must not share it.
[[maybe_unused]] static void sort_keys(SortedKeys& sorted, std::size_t count) {
  constexpr unsigned DIGIT_BITS = 11;
  std::uint64_t max_key = 0;
  for (std::size_t i = 0; i < count; ++i) max_key = std::max(max_key, sorted.keys[i]);
  SortedKeys scratch(count);
  for (unsigned shift = 0; shift < 64 && max_key >> shift; shift += DIGIT_BITS) {
    std::size_t starts[(1 << DIGIT_BITS) + 1] = {};
    const auto digit = [&](std::uint64_t key) { return key >> shift & ((1 << DIGIT_BITS) - 1); };
    for (std::size_t i = 0; i < count; ++i) ++starts[digit(sorted.keys[i]) + 1];
    for (std::size_t i = 1; i <= 1 << DIGIT_BITS; ++i) starts[i] += starts[i - 1];
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t target = starts[digit(sorted.keys[i])]++;
      scratch.keys[target] = sorted.keys[i];
      scratch.indices[target] = sorted.indices[i];
    }
    std::swap(sorted.keys, scratch.keys);
    std::swap(sorted.indices, scratch.indices);
  }
}

}  // namespace animtool
