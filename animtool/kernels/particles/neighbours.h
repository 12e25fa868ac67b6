// Points that are near each other, found by the cells of a grid.
//
// Cells are as wide as the radius that is looked in, at least. Points are sorted by cell, row
// by row, so that all that may be near a point are nine runs of them, and these move forwards
// from cell to cell: no table of cells is kept, however far apart points are.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "base/keys.h"
#include "base/memory.h"

namespace animtool {

// Places of a grid, as those loops take them that are built for several processors: up to
// NEAR_SPARE are read behind the last, and written behind the last that is found.
struct NearPlaces {
  const double *x, *y, *z;
  double most;  // square of the radius
};
struct NearRun {
  std::size_t begin, end;
};
constexpr std::size_t NEAR_SPARE = 4;
// Appends the places of runs that are within the radius of a point.
using NearFunction = std::int32_t* (*)(const NearPlaces& places, const NearRun* run,
                                       const NearRun* last, const double* at,
                                       std::int32_t* next);
NearFunction near_in_quads();  // null where the processor has no such registers

class Neighbours {
 public:
  // Points `chosen` of `points` (N, 3), null for all; what is not finite is near nobody. An
  // axis with a period goes on from its other end: it begins at `low`, and is two radii long
  // at least.
  Neighbours(const double* points, const std::int32_t* chosen, std::size_t count, double radius,
             const double* low, const double* period);

  // Places: the order of the grid.
  std::size_t size() const { return index_.size(); }
  const double* x() const { return near_places_.x; }
  const double* y() const { return near_places_.y; }
  const double* z() const { return near_places_.z; }
  const std::int32_t* index() const { return index_.data(); }  // of `points`

  // Calls with each of some points, null for all: its number among them, its index of
  // `points`, where it is within periods, and the places of those within the radius, itself
  // among them. Returns how many distances were looked at, and stops above `most`.
  template <class Function>
  double visit(const double* points, const std::int32_t* seekers, std::size_t count, double most,
               Function function) const;

  // The same for each place; of pairs `once`, with the places behind it alone.
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

  // Rows of cells that touch a cell: of each, it and those beside it are one run. The middle
  // one is the cell's own; of those behind it in the grid, the first is.
  static constexpr std::size_t RUNS = 9, OWN = 4;
  // Empty cells on each side, so that cells beside those of any seeker have keys.
  static constexpr double PAD = 2;
  // Wider than the radius by what rounding of a cell's number may come to.
  static constexpr double SLACK = 1 + 1e-9;
  // Cells of an axis: three such keys are one of 63 bits.
  static constexpr double MOST_CELLS = (1 << 21) - 2 * PAD - 1;

  double radius_, low_[3], period_[3], first_[3] = {0, 0, 0}, over_[3] = {1, 1, 1};
  double last_[3] = {0, 0, 0};  // cells of each axis, less one
  std::uint64_t row_ = 0, layer_ = 0;
  std::vector<Cell> cells_;  // those that are not empty, and one behind all
  Block<double> places_;  // of all along x, then y, then z
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
