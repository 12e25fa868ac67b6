// Minimum distances between members of a flock: braking and separation.
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/checks.h"
#include "crowds/crowds.h"
#include "particles/neighbours.h"

namespace animtool {

namespace {

constexpr double MIN_NORM = 1e-300;

// Members that have minimum distances, and the periods of periodic axes.
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
    for (std::size_t k = 0; k < 3; ++k) has_no_period_ = has_no_period_ && !(period[k] > 0);
  }

  // Visits each pair within a multiple of the largest minimum distance. Returns the number of
  // tested pairs, and stops above `max_tests`.
  template <class Function>
  double visit_pairs(const double* points, double radius_factor, double max_tests,
                     Function function) const {
    if (members_.size() < 2) return 0;
    double radius = radius_factor * max_distance_;
    for (std::size_t k = 0; k < 3; ++k)
      if (period_[k] > 0) radius = std::min(radius, period_[k] / 2);
    const Neighbours grid(points, members_.data(), members_.size(), radius, low_, period_);
    const auto visit_later = [&](std::size_t member, const std::int32_t* hit,
                                 const std::int32_t* end) {
      for (; hit < end; ++hit) {
        const std::size_t other = static_cast<std::size_t>(grid.point_indices()[*hit]);
        if (has_no_period_ || other > member) function(member, other);
      }
    };
    if (has_no_period_)
      return grid.visit_all<true>(max_tests, [&](std::size_t i, const double*,
                                                 const std::int32_t* hit, const std::int32_t* end) {
        visit_later(static_cast<std::size_t>(grid.point_indices()[i]), hit, end);
      });
    return grid.visit(points, members_.data(), members_.size(), max_tests,
                      [&](std::size_t, std::size_t member, const double*, const std::int32_t* hit,
                          const std::int32_t* end) { visit_later(member, hit, end); });
  }

  struct Gap {
    double direction[3], distance, min_distance;  // unit vector from the first to the second
  };

  Gap gap(const double* points, std::size_t i, std::size_t j) const {
    Gap gap{{0, 0, 0}, 0, (min_distances_[i] + min_distances_[j]) / 2};
    double squared_distance = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      double offset = points[3 * j + k] - points[3 * i + k];
      if (period_[k] > 0) offset -= period_[k] * std::nearbyint(offset / period_[k]);
      gap.direction[k] = offset;
      squared_distance += offset * offset;
    }
    gap.distance = std::sqrt(squared_distance);
    for (double& direction : gap.direction) direction /= std::max(gap.distance, MIN_NORM);
    return gap;
  }

 private:
  const double *min_distances_, *low_, *period_;
  std::vector<std::int32_t> members_;
  double max_distance_ = 0;
  bool has_no_period_ = true;
};

struct Pair {
  std::size_t first, second;
};

void check_spacing(const In<double, 1>& min_distances, std::size_t count,
                   const In<double, 2>& period) {
  check::numbers("min_distances", min_distances, {count});
  check::numbers("period", period, {2, 3});
}

void add_along_gap(double* values, const Pair& pair, const SpacedMembers::Gap& gap,
                   double magnitude) {
  for (std::size_t k = 0; k < 3; ++k) {
    values[3 * pair.first + k] -= magnitude * gap.direction[k];
    values[3 * pair.second + k] += magnitude * gap.direction[k];
  }
}

}  // namespace

std::tuple<Out<double, 2>, double> flock_braking(In<double, 2> points, In<double, 2> velocities,
                                                 In<double, 1> min_distances, double sight,
                                                 double min_gap, In<double, 2> period,
                                                 double max_tests) {
  const std::size_t count = check::points("points", points);
  check::shape("velocities", velocities, {count, 3});
  check_spacing(min_distances, count, period);
  if (!(sight > 1)) check::refuse("sight", check::text(sight) + " is not above 1");
  check::positive("min_gap", min_gap);
  Out<double, 2> result(count, 3);
  double test_count = 0;
  std::fill_n(result.get(), 3 * count, 0.0);
  const double *positions = points.data(), *member_velocities = velocities.data();
  const SpacedMembers members(min_distances.data(), count, period.data(), period.data() + 3);
  test_count = members.visit_pairs(positions, sight, max_tests, [&](std::size_t i, std::size_t j) {
    const SpacedMembers::Gap gap = members.gap(positions, i, j);
    double closing_speed = 0;
    for (std::size_t k = 0; k < 3; ++k)
      closing_speed -=
          (member_velocities[3 * j + k] - member_velocities[3 * i + k]) * gap.direction[k];
    if (!(closing_speed > 0)) return;
    const double remaining = std::max(gap.distance - gap.min_distance, min_gap * gap.min_distance);
    const double proximity =
        1 - (gap.distance - gap.min_distance) / ((sight - 1) * gap.min_distance);
    const double magnitude =
        std::clamp(proximity, 0.0, 1.0) * closing_speed * closing_speed / (4 * remaining);
    add_along_gap(result.get(), {i, j}, gap, magnitude);
  });
  return {std::move(result), test_count};
}

std::tuple<Out<double, 2>, double, double> flock_separate(In<double, 2> points,
                                                          In<double, 1> min_distances,
                                                          std::int64_t max_passes,
                                                          double relaxation, double clearance,
                                                          In<double, 2> period, double max_tests) {
  // Pairs are searched again after this many passes, within this multiple of the largest minimum
  // distance.
  constexpr std::int64_t SEARCH_INTERVAL = 8;
  constexpr double SEARCH_RATIO = 1.5;
  const std::size_t count = check::points("points", points);
  check_spacing(min_distances, count, period);
  check::between("max_passes", max_passes, 0, std::numeric_limits<std::int32_t>::max());
  check::positive("relaxation", relaxation);
  check::non_negative("clearance", clearance);
  Out<double, 2> result(count, 3);
  double test_count = 0, overlap = 0;
  double* positions = result.get();
  std::copy_n(points.data(), 3 * count, positions);
  const SpacedMembers members(min_distances.data(), count, period.data(), period.data() + 3);
  std::vector<Pair> pairs;
  std::vector<double> displacements;
  for (std::int64_t pass = 0; pass <= max_passes; ++pass) {
    if (pass % SEARCH_INTERVAL == 0) {
      pairs.clear();
      test_count =
          members.visit_pairs(positions, SEARCH_RATIO, max_tests,
                              [&](std::size_t i, std::size_t j) { pairs.push_back({i, j}); });
      if (test_count > max_tests) break;
    }
    overlap = 0;
    displacements.assign(3 * count, 0.0);
    for (const Pair& pair : pairs) {
      const SpacedMembers::Gap gap = members.gap(positions, pair.first, pair.second);
      const double deficit = gap.min_distance - gap.distance;
      if (!(deficit > 0)) continue;
      overlap = std::max(overlap, deficit);
      add_along_gap(displacements.data(), pair, gap,
                    relaxation / 2 * (deficit + clearance * gap.min_distance));
    }
    if (pass == max_passes || !(overlap > 0)) break;
    for (std::size_t i = 0; i < 3 * count; ++i) positions[i] += displacements[i];
  }
  return {std::move(result), overlap, test_count};
}

}  // namespace animtool
