// Relative displacement of nearby particles.
#include "springs/drift.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

namespace animtool {

namespace {

// Largest cell index in each direction; points beyond are in the last cell.
constexpr double MAX_CELL_INDEX = 1e6;
// Factor that covers rounding errors.
constexpr double ROUNDING_FACTOR = 1 + 1e-9;

using Cell = std::array<std::int32_t, 3>;

}  // namespace

void RelativeMotion::build(const std::vector<double>& x, double width) {
  width_ = width;
  double low[3] = {x[0], x[1], x[2]};
  for (std::size_t n = 0; n < x.size(); n += PARTICLE_STRIDE)
    for (std::size_t k = 0; k < 3; ++k) low[k] = std::min(low[k], x[n + k]);
  std::map<Cell, std::uint32_t> cell_numbers;
  cell_of_particle_.clear();
  for (std::size_t n = 0; n < x.size(); n += PARTICLE_STRIDE) {
    Cell cell_index;
    for (std::size_t k = 0; k < 3; ++k) {
      const double coordinate = (x[n + k] - low[k]) / width;
      cell_index[k] =
          static_cast<std::int32_t>(coordinate < MAX_CELL_INDEX ? coordinate : MAX_CELL_INDEX);
    }
    const auto number = static_cast<std::uint32_t>(cell_numbers.size());
    cell_of_particle_.push_back(cell_numbers.insert({cell_index, number}).first->second);
  }
  cell_ranges_.resize(cell_numbers.size());
  adjacent_cells_.clear();
  for (const auto& [cell_index, number] : cell_numbers)
    for (std::int32_t k = 0; k < 27; ++k) {
      const auto neighbour = cell_numbers.find(
          {cell_index[0] + k % 3 - 1, cell_index[1] + k / 3 % 3 - 1, cell_index[2] + k / 9 - 1});
      if (neighbour != cell_numbers.end() && neighbour->second > number)
        adjacent_cells_.push_back({number, neighbour->second});
    }
}

double RelativeMotion::combined_extent(const Range& a, const Range& b) {
  double size[3];
  for (std::size_t k = 0; k < 3; ++k)
    size[k] = std::max(a.high[k], b.high[k]) - std::min(a.low[k], b.low[k]);
  return std::sqrt(size[0] * size[0] + size[1] * size[1] + size[2] * size[2]) * ROUNDING_FACTOR;
}

template <class Transform>
Drift RelativeMotion::measure_relative_to(const std::vector<double>& from,
                                          const std::vector<double>& to, Transform transform) {
  constexpr double INF = std::numeric_limits<double>::infinity();
  std::fill(cell_ranges_.begin(), cell_ranges_.end(), Range{{INF, INF, INF}, {-INF, -INF, -INF}});
  for (std::size_t n = 0; n < cell_of_particle_.size(); ++n) {
    Range& range = cell_ranges_[cell_of_particle_[n]];
    const collide::Vec transformed = transform(collide::load(&from[PARTICLE_STRIDE * n]));
    const double expected_position[3] = {transformed.x, transformed.y, transformed.z};
    for (std::size_t k = 0; k < 3; ++k) {
      const double difference = to[PARTICLE_STRIDE * n + k] - expected_position[k];
      range.low[k] = std::min(range.low[k], difference);
      range.high[k] = std::max(range.high[k], difference);
    }
  }
  Drift drift;
  Range total_range = cell_ranges_[0];
  for (const Range& range : cell_ranges_) {
    drift.nearby_bound = std::max(drift.nearby_bound, combined_extent(range, range));
    for (std::size_t k = 0; k < 3; ++k) {
      total_range.low[k] = std::min(total_range.low[k], range.low[k]);
      total_range.high[k] = std::max(total_range.high[k], range.high[k]);
    }
  }
  for (const auto& [c, d] : adjacent_cells_)
    drift.nearby_bound =
        std::max(drift.nearby_bound, combined_extent(cell_ranges_[c], cell_ranges_[d]));
  drift.overall_bound = combined_extent(total_range, total_range);
  return drift;
}

Drift RelativeMotion::measure(const std::vector<double>& from, const std::vector<double>& to) {
  return measure_relative_to(from, to, [](collide::Vec p) { return p; });
}

Drift RelativeMotion::measure(const std::vector<double>& from, const std::vector<double>& to,
                              const RigidMotion& motion) {
  return measure_relative_to(from, to, motion);
}

}  // namespace animtool
