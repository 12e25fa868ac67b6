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
class Spaced {
 public:
  Spaced(const double* least, std::size_t count, const double* low, const double* period)
      : least_(least), low_(low), period_(period) {
    for (std::size_t i = 0; i < count; ++i) {
      if (!(least[i] > 0)) continue;
      who_.push_back(static_cast<std::int32_t>(i));
      largest_ = std::max(largest_, least[i]);
    }
    for (std::size_t k = 0; k < 3; ++k) open_ = open_ && !(period[k] > 0);
  }

  // Visits each pair within a multiple of the largest distance; returns the number of tested pairs,
  // and stops above `most`.
  template <class Function>
  double each_pair(const double* points, double times, double most, Function function) const {
    if (who_.size() < 2) return 0;
    double radius = times * largest_;
    for (std::size_t k = 0; k < 3; ++k)
      if (period_[k] > 0) radius = std::min(radius, period_[k] / 2);
    const Neighbours grid(points, who_.data(), who_.size(), radius, low_, period_);
    const auto all = [&](std::size_t self, const std::int32_t* hit, const std::int32_t* end) {
      for (; hit < end; ++hit) {
        const std::size_t other = static_cast<std::size_t>(grid.index()[*hit]);
        if (open_ || other > self) function(self, other);
      }
    };
    if (open_)
      return grid.visit_places<true>(most, [&](std::size_t i, const double*,
                                               const std::int32_t* hit, const std::int32_t* end) {
        all(static_cast<std::size_t>(grid.index()[i]), hit, end);
      });
    return grid.visit(points, who_.data(), who_.size(), most,
                      [&](std::size_t, std::size_t which, const double*, const std::int32_t* hit,
                          const std::int32_t* end) { all(which, hit, end); });
  }

  struct Gap {
    double way[3], far, least;  // unit vector from one to the other
  };

  Gap gap(const double* points, std::size_t i, std::size_t j) const {
    Gap made{{0, 0, 0}, 0, (least_[i] + least_[j]) / 2};
    double squared = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      double off = points[3 * j + k] - points[3 * i + k];
      if (period_[k] > 0) off -= period_[k] * std::nearbyint(off / period_[k]);
      made.way[k] = off;
      squared += off * off;
    }
    made.far = std::sqrt(squared);
    for (double& way : made.way) way /= std::max(made.far, TINY);
    return made;
  }

 private:
  const double *least_, *low_, *period_;
  std::vector<std::int32_t> who_;
  double largest_ = 0;
  bool open_ = true;
};

struct Pair {
  std::size_t one, other;
};

void check_spaced(const In<double, 1>& least, std::size_t count, const In<double, 2>& period) {
  check::numbers("least", least, {count});
  check::numbers("period", period, {2, 3});
}

void push(double* values, const Pair& pair, const Spaced::Gap& gap, double size) {
  for (std::size_t k = 0; k < 3; ++k) {
    values[3 * pair.one + k] -= size * gap.way[k];
    values[3 * pair.other + k] += size * gap.way[k];
  }
}

}  // namespace

std::tuple<Out<double, 2>, double> flock_braking(In<double, 2> points, In<double, 2> velocities,
                                                 In<double, 1> least, double seen, double room,
                                                 In<double, 2> period, double most) {
  const std::size_t count = check::points("points", points);
  check::shape("velocities", velocities, {count, 3});
  check_spaced(least, count, period);
  if (!(seen > 1)) check::refuse("seen", check::text(seen) + " is not above 1");
  check::positive("room", room);
  Out<double, 2> result(count, 3);
  double looked = 0;
  std::fill_n(result.get(), 3 * count, 0.0);
  const double *x = points.data(), *v = velocities.data();
  const Spaced spaced(least.data(), count, period.data(), period.data() + 3);
  looked = spaced.each_pair(x, seen, most, [&](std::size_t i, std::size_t j) {
    const Spaced::Gap gap = spaced.gap(x, i, j);
    double closing = 0;
    for (std::size_t k = 0; k < 3; ++k) closing -= (v[3 * j + k] - v[3 * i + k]) * gap.way[k];
    if (!(closing > 0)) return;
    const double left = std::max(gap.far - gap.least, room * gap.least);
    const double near = 1 - (gap.far - gap.least) / ((seen - 1) * gap.least);
    const double size = std::clamp(near, 0.0, 1.0) * closing * closing / (4 * left);
    push(result.get(), {i, j}, gap, size);
  });
  return {std::move(result), looked};
}

std::tuple<Out<double, 2>, double, double> flock_apart(In<double, 2> points, In<double, 1> least,
                                                       std::int64_t rounds, double share,
                                                       double clear, In<double, 2> period,
                                                       double most) {
  // Pairs are searched again after this many passes, within a multiple of the largest distance.
  constexpr std::int64_t REFRESH = 8;
  constexpr double REACH = 1.5;
  const std::size_t count = check::points("points", points);
  check_spaced(least, count, period);
  check::between("rounds", rounds, 0, std::numeric_limits<std::int32_t>::max());
  check::positive("share", share);
  check::not_negative("clear", clear);
  Out<double, 2> result(count, 3);
  double looked = 0, overlap = 0;
  double* x = result.get();
  std::copy_n(points.data(), 3 * count, x);
  const Spaced spaced(least.data(), count, period.data(), period.data() + 3);
  std::vector<Pair> pairs;
  std::vector<double> moves;
  for (std::int64_t k = 0; k <= rounds; ++k) {
    if (k % REFRESH == 0) {
      pairs.clear();
      looked = spaced.each_pair(x, REACH, most, [&](std::size_t i, std::size_t j) {
        pairs.push_back({i, j});
      });
      if (looked > most) break;
    }
    overlap = 0;
    moves.assign(3 * count, 0.0);
    for (const Pair& pair : pairs) {
      const Spaced::Gap gap = spaced.gap(x, pair.one, pair.other);
      const double lack = gap.least - gap.far;
      if (!(lack > 0)) continue;
      overlap = std::max(overlap, lack);
      push(moves.data(), pair, gap, share / 2 * (lack + clear * gap.least));
    }
    if (k == rounds || !(overlap > 0)) break;
    for (std::size_t i = 0; i < 3 * count; ++i) x[i] += moves[i];
  }
  return {std::move(result), overlap, looked};
}

}  // namespace animtool
