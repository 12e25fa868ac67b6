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
struct NearPlaces {
  const double *x, *y, *z;
  double most;  // squared radius
};
struct NearRun {
  std::size_t begin, end;
};
constexpr std::size_t NEAR_SPARE = 4;
// Appends the grid indices of runs within the radius of a point.
using NearFunction = std::int32_t* (*)(const NearPlaces& places, const NearRun* run,
                                       const NearRun* last, const double* at,
                                       std::int32_t* next);
NearFunction near_in_quads();  // null where the processor has no such registers

class Neighbours {
 public:
  // Points `chosen` of `points` (N, 3), null for all; non-finite ones have no neighbours. A
  // periodic axis wraps around: it starts at `low`, and is at least two radii long.
  Neighbours(const double* points, const std::int32_t* chosen, std::size_t count, double radius,
             const double* low, const double* period);

  // Number of grid positions, in grid order.
  std::size_t size() const { return index_.size(); }
  const double* x() const { return near_places_.x; }
  const double* y() const { return near_places_.y; }
  const double* z() const { return near_places_.z; }
  const std::int32_t* index() const { return index_.data(); }  // of `points`

  // Visits some points, null for all: the number among them, the index in `points`, the wrapped
  // position, and grid indices within the radius, itself included. Returns the number of tested
  // distances, and stops above `most`.
  template <class Function>
  double visit(const double* points, const std::int32_t* seekers, std::size_t count, double most,
               Function function) const;

  // The same for each grid position; with `once`, only with later ones.
  template <bool once, class Function>
  double visit_places(double most, Function function) const;

 private:
  struct Cell {
    std::uint64_t key;
    std::size_t begin;
  };
  template <class Function>
  void each_cell(const std::vector<Cell>& cells, Function function) const;
  SortedKeys seekers(const double* points, const std::int32_t* chosen, std::size_t count) const;
  void wrapped(const double* point, double* out) const;
  bool inside(const double* point) const;
  std::uint64_t key(const double* point) const;
  std::vector<double> images(const double* points);
  static std::vector<Cell> cells_of(const std::uint64_t* keys, std::size_t count);

  // Rows of adjacent cells: each row is one run. The middle one contains the cell itself; of later
  // ones in grid order, the first.
  static constexpr std::size_t RUNS = 9, OWN = 4;
  // Empty cells on each side, so that neighbours of any query cell have keys.
  static constexpr double PAD = 2;
  // Wider than the radius by the rounding of cell numbers.
  static constexpr double SLACK = 1 + 1e-9;
  // Largest number of cells of an axis: three such keys fit 63 bits.
  static constexpr double MOST_CELLS = (1 << 21) - 2 * PAD - 1;

  double radius_, low_[3], period_[3], first_[3] = {0, 0, 0}, over_[3] = {1, 1, 1};
  double last_[3] = {0, 0, 0};  // cells of each axis, less one
  std::uint64_t row_ = 0, layer_ = 0;
  std::vector<Cell> cells_;  // non-empty cells, and a sentinel
  Block<double> places_;  // positions along x, then y, then z
  NearPlaces near_places_{};
  NearFunction near_;
  std::vector<std::int32_t> index_;
};

template <class Function>
void Neighbours::each_cell(const std::vector<Cell>& cells, Function function) const {
  const Cell* bounds[RUNS][2];
  for (auto& bound : bounds) bound[0] = bound[1] = cells_.data();
  NearRun runs[RUNS];
  for (std::size_t c = 0; c + 1 < cells.size(); ++c) {
    std::size_t room = 0;
    for (std::size_t k = 0; k < RUNS; ++k) {
      const std::uint64_t middle =
          cells[c].key + (k / 3) * layer_ + (k % 3) * row_ - layer_ - row_;
      auto& [begin, end] = bounds[k];
      while (begin->key < middle - 1) ++begin;
      end = std::max(end, begin);
      while (end->key <= middle + 1) ++end;
      runs[k] = {begin->begin, end->begin};
      room += end->begin - begin->begin;
    }
    if (!function(cells[c].begin, cells[c + 1].begin, runs, room)) return;
  }
}

template <class Function>
double Neighbours::visit(const double* points, const std::int32_t* chosen, std::size_t count,
                         double most, Function function) const {
  const SortedKeys sorted = seekers(points, chosen, count);
  std::vector<std::int32_t> hits;
  double looked = 0;
  each_cell(cells_of(sorted.keys.get(), sorted.count),
            [&](std::size_t first, std::size_t last, const NearRun* runs, std::size_t room) {
              looked += static_cast<double>(last - first) * static_cast<double>(room);
              if (hits.size() < room + NEAR_SPARE) hits.resize(2 * room + NEAR_SPARE);
              for (std::size_t i = first; i < last && looked <= most; ++i) {
                const std::size_t number = static_cast<std::size_t>(sorted.places[i]);
                const std::size_t which =
                    chosen ? static_cast<std::size_t>(chosen[number]) : number;
                double at[3];
                wrapped(points + 3 * which, at);
                function(number, which, at, hits.data(),
                         near_(near_places_, runs, runs + RUNS, at, hits.data()));
              }
              return looked <= most;
            });
  return looked;
}

template <bool once, class Function>
double Neighbours::visit_places(double most, Function function) const {
  std::vector<std::int32_t> hits;
  double looked = 0;
  each_cell(cells_,
            [&](std::size_t first, std::size_t last, const NearRun* runs, std::size_t room) {
              looked += static_cast<double>(last - first) * static_cast<double>(room);
              if (hits.size() < room + NEAR_SPARE) hits.resize(2 * room + NEAR_SPARE);
              for (std::size_t i = first; i < last && looked <= most; ++i) {
                const double at[3] = {x()[i], y()[i], z()[i]};
                NearRun behind[RUNS];
                std::copy(runs, runs + RUNS, behind);
                if (once) behind[OWN].begin = i + 1;
                function(i, at, hits.data(),
                         near_(near_places_, behind + (once ? OWN : 0), behind + RUNS, at,
                               hits.data()));
              }
              return looked <= most;
            });
  return looked;
}

}  // namespace animtool
