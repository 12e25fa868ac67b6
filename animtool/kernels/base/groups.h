// Union-find: elements merged into groups. The smallest element represents a group.
#pragma once

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <vector>

namespace animtool {

class Groups {
 public:
  explicit Groups(std::size_t count = 0) : parents_(count) {
    std::iota(parents_.begin(), parents_.end(), std::size_t{0});
  }

  // Returns the smallest element of the group of i.
  std::size_t find_root(std::size_t i) {
    while (parents_[i] != i) i = parents_[i] = parents_[parents_[i]];
    return i;
  }
  // Merges the groups of two elements.
  void merge(std::size_t i, std::size_t j) {
    i = find_root(i), j = find_root(j);
    if (i != j) parents_[std::max(i, j)] = std::min(i, j);
  }

 private:
  std::vector<std::size_t> parents_;
};

}  // namespace animtool
