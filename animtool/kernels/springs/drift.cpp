// Relative displacement of nearby particles.
#include "springs/drift.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

namespace animtool {

namespace {

// Largest cell number in each direction; points beyond are in the last cell.
constexpr double MAX_CELLS = 1e6;
// Relative rounding error [1].
constexpr double ROUNDING = 1 + 1e-9;

using Cell = std::array<std::int32_t, 3>;

}  // namespace

void RelativeMotion::build(const std::vector<double>& x, double width) {
  width_ = width;
  double low[3] = {x[0], x[1], x[2]};
  for (std::size_t n = 0; n < x.size(); n += ROW)
    for (std::size_t k = 0; k < 3; ++k) low[k] = std::min(low[k], x[n + k]);
  std::map<Cell, std::uint32_t> numbers;
  cells_.clear();
  for (std::size_t n = 0; n < x.size(); n += ROW) {
    Cell at;
    for (std::size_t k = 0; k < 3; ++k) {
      const double cell = (x[n + k] - low[k]) / width;
      at[k] = static_cast<std::int32_t>(cell < MAX_CELLS ? cell : MAX_CELLS);
    }
    const auto number = static_cast<std::uint32_t>(numbers.size());
    cells_.push_back(numbers.insert({at, number}).first->second);
  }
  ranges_.resize(numbers.size());
  adjacent_.clear();
  for (const auto& [at, number] : numbers)
    for (std::int32_t k = 0; k < 27; ++k) {
      const auto other =
          numbers.find({at[0] + k % 3 - 1, at[1] + k / 3 % 3 - 1, at[2] + k / 9 - 1});
      if (other != numbers.end() && other->second > number)
        adjacent_.push_back({number, other->second});
    }
}

double RelativeMotion::extent(const Range& one, const Range& other) {
  double along[3];
  for (std::size_t k = 0; k < 3; ++k)
    along[k] = std::max(one.high[k], other.high[k]) - std::min(one.low[k], other.low[k]);
  return std::sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]) * ROUNDING;
}

template <class Shift>
Drift RelativeMotion::relative(const std::vector<double>& from, const std::vector<double>& to,
                               Shift shift) {
  constexpr double FAR = std::numeric_limits<double>::infinity();
  std::fill(ranges_.begin(), ranges_.end(), Range{{FAR, FAR, FAR}, {-FAR, -FAR, -FAR}});
  for (std::size_t n = 0; n < cells_.size(); ++n) {
    Range& range = ranges_[cells_[n]];
    const collide::Vec at = shift(collide::load(&from[ROW * n]));
    const double came[3] = {at.x, at.y, at.z};
    for (std::size_t k = 0; k < 3; ++k) {
      const double relative = to[ROW * n + k] - came[k];
      range.low[k] = std::min(range.low[k], relative);
      range.high[k] = std::max(range.high[k], relative);
    }
  }
  Drift drift;
  Range all = ranges_[0];
  for (const Range& range : ranges_) {
    drift.near = std::max(drift.near, extent(range, range));
    for (std::size_t k = 0; k < 3; ++k) {
      all.low[k] = std::min(all.low[k], range.low[k]);
      all.high[k] = std::max(all.high[k], range.high[k]);
    }
  }
  for (const auto& [c, d] : adjacent_)
    drift.near = std::max(drift.near, extent(ranges_[c], ranges_[d]));
  drift.all = extent(all, all);
  return drift;
}

Drift RelativeMotion::between(const std::vector<double>& from, const std::vector<double>& to) {
  return relative(from, to, [](collide::Vec p) { return p; });
}

Drift RelativeMotion::between(const std::vector<double>& from, const std::vector<double>& to,
                              const RigidMotion& shift) {
  return relative(from, to, shift);
}

}  // namespace animtool
