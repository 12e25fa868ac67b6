// Forces between members of a flock that see each other.
#include <cmath>

#include "base/checks.h"
#include "base/vector.h"
#include "crowds/crowds.h"
#include "particles/neighbours.h"

namespace animtool {

namespace {

struct Interaction {
  double weight, radius;
};

struct FlockRule {
  double radius, cosine;
  std::size_t nearest;  // 0 for all
  Interaction attraction, alignment, repulsion;
  double softening;

  // Whether pairs in sight interact symmetrically.
  bool mutual() const {
    return !(cosine > -1) && !nearest && attraction.radius >= radius && alignment.radius >= radius;
  }
};

// The offset to another over its squared length, for repulsion.
Vec repulsion(const FlockRule& rule, const Vec& off, double squared) {
  const bool pushes = squared <= rule.repulsion.radius * rule.repulsion.radius && squared > 0;
  return off * (pushes ? 1 / (squared + rule.softening * rule.softening) : 0.0);
}

// Symmetric interactions: each pair is visited once.
double add_mutual(const FlockRule& rule, const Neighbours& grid, const Vec* velocities,
                  double max_tests, double* out, std::int32_t* counts) {
  struct Sums {
    Vec pull, away;
  };
  const Block<Sums> sums = block<Sums>(grid.size());
  std::fill_n(sums.get(), grid.size(), Sums());
  const Block<std::int32_t> sight_counts = block<std::int32_t>(grid.size());
  std::fill_n(sight_counts.get(), grid.size(), 0);
  const double *x = grid.x(), *y = grid.y(), *z = grid.z();
  const double tested = grid.visit_all<true>(
      max_tests,
      [&](std::size_t i, const double* at, const std::int32_t* hit, const std::int32_t* end) {
        const Vec here = load(at), velocity = velocities[i];
        Sums sum_i;
        sight_counts[i] += static_cast<std::int32_t>(end - hit);
        for (; hit < end; ++hit) {
          const std::size_t j = static_cast<std::size_t>(*hit);
          const Vec off = Vec{x[j], y[j], z[j]} - here;
          Vec pull = off * rule.attraction.weight;
          pull += (velocities[j] - velocity) * rule.alignment.weight;
          const Vec away = repulsion(rule, off, dot(off, off));
          sum_i.pull += pull;
          sum_i.away += away;
          sums[j].pull -= pull;
          sums[j].away -= away;
          ++sight_counts[j];
        }
        sums[i].pull += sum_i.pull;
        sums[i].away += sum_i.away;
      });
  for (std::size_t i = 0; i < grid.size(); ++i) {
    const std::size_t which = static_cast<std::size_t>(grid.index()[i]);
    Vec sum = sums[i].pull * (sight_counts[i] ? 1.0 / sight_counts[i] : 0.0);
    sum -= sums[i].away * rule.repulsion.weight;
    out[3 * which] = sum.x, out[3 * which + 1] = sum.y, out[3 * which + 2] = sum.z;
    counts[which] = sight_counts[i];
  }
  return tested;
}

// The forces on one member from those it sees among its neighbours.
class NeighbourForces {
 public:
  NeighbourForces(const FlockRule& rule, const Neighbours& grid, const Vec* velocities)
      : rule_(rule), grid_(grid), velocities_(velocities) {}

  std::size_t add(std::size_t self, const Vec& here, const Vec& velocity, const std::int32_t* hit,
                  const std::int32_t* end, double* out) {
    find_visible(self, here, velocity, hit, end);
    const double follow = rule_.attraction.radius * rule_.attraction.radius;
    const double align = rule_.alignment.radius * rule_.alignment.radius;
    Vec centre, heading, away;
    double followed = 0, aligned = 0;
    for (const Neighbour& one : neighbours_) {
      if (one.squared <= follow) centre += one.off, followed += 1;
      if (one.squared <= align) heading += velocities_[one.at] - velocity, aligned += 1;
      away += repulsion(rule_, one.off, one.squared);
    }
    Vec sum = centre * (followed > 0 ? rule_.attraction.weight / followed : 0.0);
    sum += heading * (aligned > 0 ? rule_.alignment.weight / aligned : 0.0);
    sum -= away * rule_.repulsion.weight;
    out[0] = sum.x, out[1] = sum.y, out[2] = sum.z;
    return neighbours_.size();
  }

 private:
  struct Neighbour {
    Vec off;
    double squared;
    std::size_t at;
  };

  void find_visible(std::size_t self, const Vec& here, const Vec& velocity, const std::int32_t* hit,
                    const std::int32_t* end) {
    const double min_projection = rule_.cosine * std::sqrt(dot(velocity, velocity));
    const std::int32_t* index = grid_.index();
    neighbours_.clear();
    for (; hit < end; ++hit) {
      const std::size_t j = static_cast<std::size_t>(*hit);
      if (static_cast<std::size_t>(index[j]) == self) continue;
      const Vec off = Vec{grid_.x()[j], grid_.y()[j], grid_.z()[j]} - here;
      const double squared = dot(off, off);
      if (rule_.cosine > -1 && dot(off, velocity) < min_projection * std::sqrt(squared)) continue;
      neighbours_.push_back({off, squared, j});
    }
    if (!rule_.nearest || neighbours_.size() <= rule_.nearest) return;
    // Of two at equal distance the first is taken, whatever the order of the grid.
    const auto nearer = [&](const Neighbour& a, const Neighbour& b) {
      return a.squared != b.squared ? a.squared < b.squared : index[a.at] < index[b.at];
    };
    const auto last = neighbours_.begin() + static_cast<std::ptrdiff_t>(rule_.nearest);
    std::nth_element(neighbours_.begin(), last - 1, neighbours_.end(), nearer);
    neighbours_.erase(last, neighbours_.end());
    std::sort(neighbours_.begin(), neighbours_.end(), nearer);
  }

  const FlockRule& rule_;
  const Neighbours& grid_;
  const Vec* velocities_;
  std::vector<Neighbour> neighbours_;
};

Interaction interaction(const char* name, const In<double, 1>& pair) {
  check::shape(name, pair, {2});
  check::finite(name, pair);
  check::not_negative(name, pair.data()[1]);
  return {pair.data()[0], pair.data()[1]};
}

}  // namespace

std::tuple<Out<double, 2>, Out<std::int32_t, 1>, double> flock_accelerations(
    In<double, 2> points, In<double, 2> velocities, std::optional<In<std::int32_t, 1>> members,
    std::optional<In<std::int32_t, 1>> others, double radius, double cosine, std::int64_t nearest,
    In<double, 1> attraction, In<double, 1> alignment, In<double, 1> repulsion, double softening,
    In<double, 2> period, double max_tests) {
  const std::size_t count = check::points("points", points);
  check::shape("velocities", velocities, {count, 3});
  check::positive("radius", radius);
  check::between("cosine", cosine, -1, 1);
  check::between("nearest", nearest, 0, std::numeric_limits<std::int32_t>::max());
  check::not_negative("softening", softening);
  check::numbers("period", period, {2, 3});
  const double* periods = period.data() + 3;
  for (std::size_t k = 0; k < 3; ++k)
    if (periods[k] != 0 && !(periods[k] >= 2 * radius))
      check::refuse("period", check::text(periods[k]) + " is not 0 or two radii");
  for (const auto* which : {&members, &others})
    if (*which)
      check::indices(which == &members ? "members" : "others", **which, 0,
                     static_cast<std::int64_t>(count));
  const FlockRule rule{radius,
                       cosine,
                       static_cast<std::size_t>(nearest),
                       interaction("attraction", attraction),
                       interaction("alignment", alignment),
                       interaction("repulsion", repulsion),
                       softening};
  const std::size_t size = members ? members->shape(0) : count;
  Out<double, 2> result(size, 3);
  Out<std::int32_t, 1> counts(size);
  double tested = 0;
  std::fill_n(result.get(), 3 * size, 0.0);
  std::fill_n(counts.get(), size, 0);
  const Neighbours grid(points.data(), others ? others->data() : nullptr,
                        others ? others->shape(0) : count, radius, period.data(), periods);
  const Block<Vec> sorted = block<Vec>(grid.size());
  for (std::size_t i = 0; i < grid.size(); ++i)
    sorted[i] = load(velocities.data() + 3 * static_cast<std::size_t>(grid.index()[i]));
  const bool open = periods[0] == 0 && periods[1] == 0 && periods[2] == 0;
  const bool all = open && !members && !others;
  NeighbourForces forces(rule, grid, sorted.get());
  const auto add = [&](std::size_t number, std::size_t which, const Vec& at, const Vec& velocity,
                       const std::int32_t* hit, const std::int32_t* end) {
    const std::size_t count = forces.add(which, at, velocity, hit, end, result.get() + 3 * number);
    counts.get()[number] = static_cast<std::int32_t>(count);
  };
  if (all && rule.mutual())
    tested = add_mutual(rule, grid, sorted.get(), max_tests, result.get(), counts.get());
  else if (all)
    tested = grid.visit_all<false>(
        max_tests,
        [&](std::size_t i, const double* at, const std::int32_t* hit, const std::int32_t* end) {
          const std::size_t which = static_cast<std::size_t>(grid.index()[i]);
          add(which, which, load(at), sorted[i], hit, end);
        });
  else
    tested =
        grid.visit(points.data(), members ? members->data() : nullptr, size, max_tests,
                   [&](std::size_t number, std::size_t which, const double* at,
                       const std::int32_t* hit, const std::int32_t* end) {
                     add(number, which, load(at), load(velocities.data() + 3 * which), hit, end);
                   });
  return {std::move(result), std::move(counts), tested};
}

}  // namespace animtool
