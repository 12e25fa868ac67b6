// Spatial hash of points.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "springs/rows.h"

namespace animtool {

// A spatial hash of points; indices ascend in each cell.
class PointGrid {
 public:
  // Builds the hash from rows of points.
  void build(const double* rows, std::size_t count, double cell_size);

  // Calls a function with the index and position of each point that may be in a box.
  template <class Function>
  void visit(const double* low, const double* high, Function function) const;

 private:
  std::uint64_t key(const std::int64_t* cell) const {
    return static_cast<std::uint64_t>(cell[0]) | static_cast<std::uint64_t>(cell[1]) << 20 |
           static_cast<std::uint64_t>(cell[2]) << 40;
  }
  std::size_t bucket(std::uint64_t key) const {
    return static_cast<std::size_t>((key * 0x9e3779b97f4a7c15u) >> 32) & mask_;
  }
  std::int64_t cell_of(double coordinate, std::size_t axis) const {
    // NaN is in cell 0.
    const double index = (coordinate - low_[axis]) * inverse_cell_;
    return index > 0 ? static_cast<std::int64_t>(std::min(index, double(MAX_CELL_INDEX))) : 0;
  }

  // Largest cell index in each direction.
  static constexpr std::int64_t MAX_CELL_INDEX = (1 << 20) - 1;

  std::size_t count_ = 0, mask_ = 0;
  double low_[3] = {0, 0, 0}, inverse_cell_ = 1;
  std::vector<std::uint32_t> starts_;
  std::vector<std::uint64_t> keys_;
  std::vector<std::int32_t> points_;
  std::vector<double> positions_;  // rows of positions, sorted
};

template <class Function>
void PointGrid::visit(const double* low, const double* high, Function function) const {
  std::int64_t first[3], last[3];
  double cells = 1;
  for (std::size_t k = 0; k < 3; ++k) {
    first[k] = cell_of(low[k], k);
    last[k] = cell_of(high[k], k);
    cells *= static_cast<double>(last[k] - first[k] + 1);
  }
  // If a box has more cells than there are points, it is faster to test all points.
  if (cells > static_cast<double>(count_)) {
    for (std::size_t i = 0; i < count_; ++i) function(points_[i], &positions_[PARTICLE_STRIDE * i]);
    return;
  }
  std::int64_t cell[3];
  for (cell[2] = first[2]; cell[2] <= last[2]; ++cell[2])
    for (cell[1] = first[1]; cell[1] <= last[1]; ++cell[1])
      for (cell[0] = first[0]; cell[0] <= last[0]; ++cell[0]) {
        const std::uint64_t cell_key = key(cell);
        const std::size_t b = bucket(cell_key);
        for (std::size_t i = starts_[b]; i < starts_[b + 1]; ++i)
          if (keys_[i] == cell_key) function(points_[i], &positions_[PARTICLE_STRIDE * i]);
      }
}

}  // namespace animtool
