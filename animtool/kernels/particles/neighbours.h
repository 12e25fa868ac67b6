// Neighbour search by the cells of a grid.
// Cells are at least as wide as the search radius. Points are sorted by cell, row by row. The
// neighbours of a point are thus in nine runs of points, which move forwards from cell to cell. No
// table of cells is stored, so the extent of the points does not matter.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "base/keys.h"
#include "base/memory.h"

namespace animtool {

// Grid positions in the layout of functions that are compiled for several processors. Up to
// GRID_PADDING numbers are read past the end, and written past the last match.
struct GridPoints {
  const double *x, *y, *z;
  double squared_radius;  // of the search radius
};
struct GridRun {
  std::size_t begin, end;
};
constexpr std::size_t GRID_PADDING = 4;
// Appends the grid indices of points in runs that are within the radius of a point, and returns the
// new end.
using NeighbourFunction = std::int32_t* (*)(const GridPoints& points, const GridRun* run,
                                            const GridRun* last, const double* point,
                                            std::int32_t* next);
NeighbourFunction neighbours_in_quads();  // null if the processor has no registers of four doubles

class Neighbours {
 public:
  // Sorts the points `subset` of `points` (N, 3); null means all. Points that are not finite have
  // no neighbours. A periodic axis starts at `low`, and is at least two radii long.
  Neighbours(const double* points, const std::int32_t* subset, std::size_t count, double radius,
             const double* low, const double* period);

  // The number of grid positions, in grid order.
  std::size_t size() const { return point_indices_.size(); }
  const double* x() const { return sorted_points_.x; }
  const double* y() const { return sorted_points_.y; }
  const double* z() const { return sorted_points_.z; }
  const std::int32_t* point_indices() const {
    return point_indices_.data();
  }  // indices into `points`

  // Visits some points; null means all. The function receives the number of a visited point, its
  // index in `points`, its wrapped position, and the grid indices of all points within the radius,
  // including its own. Returns the number of tested distances, and stops above `max_tests`.
  template <class Function>
  double visit(const double* points, const std::int32_t* subset, std::size_t count,
               double max_tests, Function function) const;

  // Visits every grid position in the same way. With `visits_later_only`, the function receives
  // only later neighbours.
  template <bool visits_later_only, class Function>
  double visit_all(double max_tests, Function function) const;

 private:
  struct Cell {
    std::uint64_t key;
    std::size_t begin;
  };
  template <class Function>
  void for_each_cell(const std::vector<Cell>& cells, Function function) const;
  SortedKeys query_keys(const double* points, const std::int32_t* subset, std::size_t count) const;
  void wrap_into_period(const double* point, double* out) const;
  bool is_near_grid(const double* point) const;
  std::uint64_t find_key(const double* point) const;
  std::vector<double> add_images(const double* points);
  static std::vector<Cell> find_cells(const std::uint64_t* keys, std::size_t count);

  // Rows of adjacent cells, each of which is one run. The middle run contains the cell itself. It
  // is the first run that contains later points.
  static constexpr std::size_t RUN_COUNT = 9, CENTRE_RUN = 4;
  // Empty cells on each side, so that the neighbours of every queried cell have keys.
  static constexpr double MARGIN_CELLS = 2;
  // Cells are wider than the radius by the rounding error of cell numbers.
  static constexpr double CELL_WIDTH_FACTOR = 1 + 1e-9;
  // The largest number of cells along an axis. Three such numbers fit into 63 bits.
  static constexpr double MAX_CELLS_PER_AXIS = (1 << 21) - 2 * MARGIN_CELLS - 1;

  double radius_, low_[3], period_[3], origin_[3] = {0, 0, 0}, inverse_cell_[3] = {1, 1, 1};
  double max_cell_index_[3] = {0, 0, 0};  // the number of cells along each axis, minus one
  std::uint64_t row_stride_ = 0, layer_stride_ = 0;
  std::vector<Cell> cells_;    // cells that contain points, and a sentinel
  Block<double> grid_points_;  // positions along x, then y, then z
  GridPoints sorted_points_{};
  NeighbourFunction find_neighbours_;
  std::vector<std::int32_t> point_indices_;
};

template <class Function>
void Neighbours::for_each_cell(const std::vector<Cell>& cells, Function function) const {
  const Cell* bounds[RUN_COUNT][2];
  for (auto& bound : bounds) bound[0] = bound[1] = cells_.data();
  GridRun runs[RUN_COUNT];
  for (std::size_t c = 0; c + 1 < cells.size(); ++c) {
    std::size_t capacity = 0;
    for (std::size_t k = 0; k < RUN_COUNT; ++k) {
      const std::uint64_t middle = cells[c].key + (k / 3) * layer_stride_ + (k % 3) * row_stride_ -
                                   layer_stride_ - row_stride_;
      auto& [begin, end] = bounds[k];
      while (begin->key < middle - 1) ++begin;
      end = std::max(end, begin);
      while (end->key <= middle + 1) ++end;
      runs[k] = {begin->begin, end->begin};
      capacity += end->begin - begin->begin;
    }
    if (!function(cells[c].begin, cells[c + 1].begin, runs, capacity)) return;
  }
}

template <class Function>
double Neighbours::visit(const double* points, const std::int32_t* subset, std::size_t count,
                         double max_tests, Function function) const {
  const SortedKeys sorted = query_keys(points, subset, count);
  std::vector<std::int32_t> hits;
  double test_count = 0;
  for_each_cell(
      find_cells(sorted.keys.get(), sorted.count),
      [&](std::size_t first, std::size_t last, const GridRun* runs, std::size_t capacity) {
        test_count += static_cast<double>(last - first) * static_cast<double>(capacity);
        if (hits.size() < capacity + GRID_PADDING) hits.resize(2 * capacity + GRID_PADDING);
        for (std::size_t i = first; i < last && test_count <= max_tests; ++i) {
          const std::size_t query = static_cast<std::size_t>(sorted.indices[i]);
          const std::size_t point_index = subset ? static_cast<std::size_t>(subset[query]) : query;
          double position[3];
          wrap_into_period(points + 3 * point_index, position);
          function(query, point_index, position, hits.data(),
                   find_neighbours_(sorted_points_, runs, runs + RUN_COUNT, position, hits.data()));
        }
        return test_count <= max_tests;
      });
  return test_count;
}

template <bool visits_later_only, class Function>
double Neighbours::visit_all(double max_tests, Function function) const {
  std::vector<std::int32_t> hits;
  double test_count = 0;
  for_each_cell(
      cells_, [&](std::size_t first, std::size_t last, const GridRun* runs, std::size_t capacity) {
        test_count += static_cast<double>(last - first) * static_cast<double>(capacity);
        if (hits.size() < capacity + GRID_PADDING) hits.resize(2 * capacity + GRID_PADDING);
        for (std::size_t i = first; i < last && test_count <= max_tests; ++i) {
          const double position[3] = {x()[i], y()[i], z()[i]};
          GridRun searched_runs[RUN_COUNT];
          std::copy(runs, runs + RUN_COUNT, searched_runs);
          if (visits_later_only) searched_runs[CENTRE_RUN].begin = i + 1;
          function(
              i, position, hits.data(),
              find_neighbours_(sorted_points_, searched_runs + (visits_later_only ? CENTRE_RUN : 0),
                               searched_runs + RUN_COUNT, position, hits.data()));
        }
        return test_count <= max_tests;
      });
  return test_count;
}

}  // namespace animtool
