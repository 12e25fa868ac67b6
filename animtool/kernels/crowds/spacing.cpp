// Minimum distances of members of a flock: braking and separation.
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/checks.h"
#include "crowds/crowds.h"
#include "particles/neighbours.h"

namespace animtool {

namespace {

constexpr double TINY = 1e-300;

// Members with minimum distances, and the periods of periodic axes.
class SpacedMembers {
 public:
  SpacedMembers(const double* min_distances, std::size_t count, const double* low,
                const double* period)
      : min_distances_(min_distances), low_(low), period_(period) {
    for (std::size_t i = 0; i < count; ++i) {
      if (!(min_distances[i] > 0)) continue;
      members_.push_back(static_cast<std::int32_t>(i));
      max_distance_ = std::max(max_distance_, min_distances[i]);
    }
    for (std::size_t k = 0; k < 3; ++k) open_ = open_ && !(period[k] > 0);
  }

  // Visits each pair within a multiple of the largest distance; returns the number of tested pairs,
  // and stops above `most`.
  template <class Function>
  double visit_pairs(const double* points, double multiple, double max_tests,
                     Function function) const {
    if (members_.size() < 2) return 0;
    double radius = multiple * max_distance_;
    for (std::size_t k = 0; k < 3; ++k)
      if (period_[k] > 0) radius = std::min(radius, period_[k] / 2);
    const Neighbours grid(points, members_.data(), members_.size(), radius, low_, period_);
    const auto all = [&](std::size_t self, const std::int32_t* hit, const std::int32_t* end) {
      for (; hit < end; ++hit) {
        const std::size_t other = static_cast<std::size_t>(grid.index()[*hit]);
        if (open_ || other > self) function(self, other);
      }
    };
    if (open_)
      return grid.visit_all<true>(max_tests, [&](std::size_t i, const double*,
                                                 const std::int32_t* hit, const std::int32_t* end) {
        all(static_cast<std::size_t>(grid.index()[i]), hit, end);
      });
    return grid.visit(points, members_.data(), members_.size(), max_tests,
                      [&](std::size_t, std::size_t which, const double*, const std::int32_t* hit,
                          const std::int32_t* end) { all(which, hit, end); });
  }

  struct Gap {
    double direction[3], distance, min_distance;  // unit vector from one to the other
  };

  Gap gap(const double* points, std::size_t i, std::size_t j) const {
    Gap gap{{0, 0, 0}, 0, (min_distances_[i] + min_distances_[j]) / 2};
    double squared = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      double off = points[3 * j + k] - points[3 * i + k];
      if (period_[k] > 0) off -= period_[k] * std::nearbyint(off / period_[k]);
      gap.direction[k] = off;
      squared += off * off;
    }
    gap.distance = std::sqrt(squared);
    for (double& direction : gap.direction) direction /= std::max(gap.distance, TINY);
    return gap;
  }

 private:
  const double *min_distances_, *low_, *period_;
  std::vector<std::int32_t> members_;
  double max_distance_ = 0;
  bool open_ = true;
};

struct Pair {
  std::size_t one, other;
};

void check_spaced(const In<double, 1>& min_distances, std::size_t count,
                  const In<double, 2>& period) {
  check::numbers("min_distances", min_distances, {count});
  check::numbers("period", period, {2, 3});
}

void push(double* values, const Pair& pair, const SpacedMembers::Gap& gap, double size) {
  for (std::size_t k = 0; k < 3; ++k) {
    values[3 * pair.one + k] -= size * gap.direction[k];
    values[3 * pair.other + k] += size * gap.direction[k];
  }
}

}  // namespace

std::tuple<Out<double, 2>, double> flock_braking(In<double, 2> points, In<double, 2> velocities,
                                                 In<double, 1> min_distances, double sight,
                                                 double min_gap, In<double, 2> period,
                                                 double max_tests) {
  const std::size_t count = check::points("points", points);
  check::shape("velocities", velocities, {count, 3});
  check_spaced(min_distances, count, period);
  if (!(sight > 1)) check::refuse("sight", check::text(sight) + " is not above 1");
  check::positive("min_gap", min_gap);
  Out<double, 2> result(count, 3);
  double tested = 0;
  std::fill_n(result.get(), 3 * count, 0.0);
  const double *x = points.data(), *v = velocities.data();
  const SpacedMembers spaced(min_distances.data(), count, period.data(), period.data() + 3);
  tested = spaced.visit_pairs(x, sight, max_tests, [&](std::size_t i, std::size_t j) {
    const SpacedMembers::Gap gap = spaced.gap(x, i, j);
    double closing = 0;
    for (std::size_t k = 0; k < 3; ++k) closing -= (v[3 * j + k] - v[3 * i + k]) * gap.direction[k];
    if (!(closing > 0)) return;
    const double remaining = std::max(gap.distance - gap.min_distance, min_gap * gap.min_distance);
    const double proximity =
        1 - (gap.distance - gap.min_distance) / ((sight - 1) * gap.min_distance);
    const double size = std::clamp(proximity, 0.0, 1.0) * closing * closing / (4 * remaining);
    push(result.get(), {i, j}, gap, size);
  });
  return {std::move(result), tested};
}

std::tuple<Out<double, 2>, double, double> flock_separate(In<double, 2> points,
                                                          In<double, 1> min_distances,
                                                          std::int64_t max_passes,
                                                          double relaxation, double clearance,
                                                          In<double, 2> period, double max_tests) {
  // Pairs are searched again after this many passes, within a multiple of the largest distance.
  constexpr std::int64_t REFRESH = 8;
  constexpr double REACH = 1.5;
  const std::size_t count = check::points("points", points);
  check_spaced(min_distances, count, period);
  check::between("max_passes", max_passes, 0, std::numeric_limits<std::int32_t>::max());
  check::positive("relaxation", relaxation);
  check::not_negative("clearance", clearance);
  Out<double, 2> result(count, 3);
  double tested = 0, overlap = 0;
  double* x = result.get();
  std::copy_n(points.data(), 3 * count, x);
  const SpacedMembers spaced(min_distances.data(), count, period.data(), period.data() + 3);
  std::vector<Pair> pairs;
  std::vector<double> moves;
  for (std::int64_t k = 0; k <= max_passes; ++k) {
    if (k % REFRESH == 0) {
      pairs.clear();
      tested = spaced.visit_pairs(x, REACH, max_tests,
                                  [&](std::size_t i, std::size_t j) { pairs.push_back({i, j}); });
      if (tested > max_tests) break;
    }
    overlap = 0;
    moves.assign(3 * count, 0.0);
    for (const Pair& pair : pairs) {
      const SpacedMembers::Gap gap = spaced.gap(x, pair.one, pair.other);
      const double deficit = gap.min_distance - gap.distance;
      if (!(deficit > 0)) continue;
      overlap = std::max(overlap, deficit);
      push(moves.data(), pair, gap, relaxation / 2 * (deficit + clearance * gap.min_distance));
    }
    if (k == max_passes || !(overlap > 0)) break;
    for (std::size_t i = 0; i < 3 * count; ++i) x[i] += moves[i];
  }
  return {std::move(result), overlap, tested};
}

}  // namespace animtool
