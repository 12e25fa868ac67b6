// Neighbour search by the cells of a grid.
//
// Cells are at least as wide as the search radius. Points are sorted by cell, row by row, so that
// the neighbours of a point are in nine runs, which move forwards from cell to cell: no cell table
// is kept, whatever the extent of the points.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "base/keys.h"
#include "base/memory.h"

namespace animtool {

// Grid positions, in the layout of loops built for several processors: up to NEAR_SPARE are read
// past the end, and written past the last match.
struct GridPoints {
  const double *x, *y, *z;
  double squared_radius;  // squared radius
};
struct GridRun {
  std::size_t begin, end;
};
constexpr std::size_t GRID_PADDING = 4;
// Appends the grid indices of runs within the radius of a point.
using NeighbourFunction = std::int32_t* (*)(const GridPoints& points, const GridRun* run,
                                            const GridRun* last, const double* at,
                                            std::int32_t* next);
NeighbourFunction neighbours_in_quads();  // null where the processor has no such registers

class Neighbours {
 public:
  // Points `subset` of `points` (N, 3), null for all; non-finite ones have no neighbours. A
  // periodic axis wraps around: it starts at `low`, and is at least two radii long.
  Neighbours(const double* points, const std::int32_t* subset, std::size_t count, double radius,
             const double* low, const double* period);

  // Number of grid positions, in grid order.
  std::size_t size() const { return index_.size(); }
  const double* x() const { return sorted_points_.x; }
  const double* y() const { return sorted_points_.y; }
  const double* z() const { return sorted_points_.z; }
  const std::int32_t* index() const { return index_.data(); }  // of `points`

  // Visits some points, null for all: the number among them, the index in `points`, the wrapped
  // position, and grid indices within the radius, itself included. Returns the number of tested
  // distances, and stops above `max_tests`.
  template <class Function>
  double visit(const double* points, const std::int32_t* query_keys, std::size_t count,
               double max_tests, Function function) const;

  // The same for each grid position; with `later_only`, only with later ones.
  template <bool later_only, class Function>
  double visit_all(double max_tests, Function function) const;

 private:
  struct Cell {
    std::uint64_t key;
    std::size_t begin;
  };
  template <class Function>
  void each_cell(const std::vector<Cell>& cells, Function function) const;
  SortedKeys query_keys(const double* points, const std::int32_t* subset, std::size_t count) const;
  void wrapped(const double* point, double* out) const;
  bool inside(const double* point) const;
  std::uint64_t key(const double* point) const;
  std::vector<double> images(const double* points);
  static std::vector<Cell> cells_of(const std::uint64_t* keys, std::size_t count);

  // Rows of adjacent cells: each row is one run. The middle one contains the cell itself; of later
  // ones in grid order, the first.
  static constexpr std::size_t RUNS = 9, CENTRE = 4;
  // Empty cells on each side, so that neighbours of any query cell have keys.
  static constexpr double PAD = 2;
  // Wider than the radius by the rounding of cell numbers.
  static constexpr double SLACK = 1 + 1e-9;
  // Largest number of cells of an axis: three such keys fit 63 bits.
  static constexpr double MAX_CELLS = (1 << 21) - 2 * PAD - 1;

  double radius_, low_[3], period_[3], origin_[3] = {0, 0, 0}, inverse_cell_[3] = {1, 1, 1};
  double last_cell_[3] = {0, 0, 0};  // cells of each axis, less one
  std::uint64_t row_ = 0, layer_ = 0;
  std::vector<Cell> cells_;    // non-empty cells, and a sentinel
  Block<double> grid_points_;  // positions along x, then y, then z
  GridPoints sorted_points_{};
  NeighbourFunction find_neighbours_;
  std::vector<std::int32_t> index_;
};

template <class Function>
void Neighbours::each_cell(const std::vector<Cell>& cells, Function function) const {
  const Cell* bounds[RUNS][2];
  for (auto& bound : bounds) bound[0] = bound[1] = cells_.data();
  GridRun runs[RUNS];
  for (std::size_t c = 0; c + 1 < cells.size(); ++c) {
    std::size_t capacity = 0;
    for (std::size_t k = 0; k < RUNS; ++k) {
      const std::uint64_t middle = cells[c].key + (k / 3) * layer_ + (k % 3) * row_ - layer_ - row_;
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
  double tested = 0;
  each_cell(cells_of(sorted.keys.get(), sorted.count),
            [&](std::size_t first, std::size_t last, const GridRun* runs, std::size_t capacity) {
              tested += static_cast<double>(last - first) * static_cast<double>(capacity);
              if (hits.size() < capacity + GRID_PADDING) hits.resize(2 * capacity + GRID_PADDING);
              for (std::size_t i = first; i < last && tested <= max_tests; ++i) {
                const std::size_t number = static_cast<std::size_t>(sorted.indices[i]);
                const std::size_t which =
                    subset ? static_cast<std::size_t>(subset[number]) : number;
                double at[3];
                wrapped(points + 3 * which, at);
                function(number, which, at, hits.data(),
                         find_neighbours_(sorted_points_, runs, runs + RUNS, at, hits.data()));
              }
              return tested <= max_tests;
            });
  return tested;
}

template <bool later_only, class Function>
double Neighbours::visit_all(double max_tests, Function function) const {
  std::vector<std::int32_t> hits;
  double tested = 0;
  each_cell(cells_,
            [&](std::size_t first, std::size_t last, const GridRun* runs, std::size_t capacity) {
              tested += static_cast<double>(last - first) * static_cast<double>(capacity);
              if (hits.size() < capacity + GRID_PADDING) hits.resize(2 * capacity + GRID_PADDING);
              for (std::size_t i = first; i < last && tested <= max_tests; ++i) {
                const double at[3] = {x()[i], y()[i], z()[i]};
                GridRun searched[RUNS];
                std::copy(runs, runs + RUNS, searched);
                if (later_only) searched[CENTRE].begin = i + 1;
                function(i, at, hits.data(),
                         find_neighbours_(sorted_points_, searched + (later_only ? CENTRE : 0),
                                          searched + RUNS, at, hits.data()));
              }
              return tested <= max_tests;
            });
  return tested;
}

}  // namespace animtool
