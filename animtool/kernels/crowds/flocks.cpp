// Forces between members of a flock that see each other.
#include <cmath>

#include "base/checks.h"
#include "base/vector.h"
#include "crowds/crowds.h"
#include "particles/neighbours.h"

namespace animtool {

namespace {

struct Pull {
  double weight, radius;
};

struct Rule {
  double radius, cosine;
  std::size_t nearest;  // 0 for all
  Pull attraction, alignment, repulsion;
  double softening;

  // Whether pairs in sight interact symmetrically.
  bool mutual() const {
    return !(cosine > -1) && !nearest && attraction.radius >= radius &&
           alignment.radius >= radius;
  }
};

// The offset to another over its squared length, for repulsion.
Vec shove(const Rule& rule, const Vec& off, double squared) {
  const bool pushes = squared <= rule.repulsion.radius * rule.repulsion.radius && squared > 0;
  return off * (pushes ? 1 / (squared + rule.softening * rule.softening) : 0.0);
}

// Symmetric interactions: each pair is visited once.
double together(const Rule& rule, const Neighbours& grid, const Vec* velocities, double most,
                double* out, std::int32_t* counts) {
  struct Sums {
    Vec pull, away;
  };
  const Block<Sums> sums = block<Sums>(grid.size());
  std::fill_n(sums.get(), grid.size(), Sums());
  const Block<std::int32_t> seen = block<std::int32_t>(grid.size());
  std::fill_n(seen.get(), grid.size(), 0);
  const double *x = grid.x(), *y = grid.y(), *z = grid.z();
  const double looked = grid.visit_places<true>(
      most, [&](std::size_t i, const double* at, const std::int32_t* hit, const std::int32_t* end) {
        const Vec here = load(at), velocity = velocities[i];
        Sums own;
        seen[i] += static_cast<std::int32_t>(end - hit);
        for (; hit < end; ++hit) {
          const std::size_t j = static_cast<std::size_t>(*hit);
          const Vec off = Vec{x[j], y[j], z[j]} - here;
          Vec pull = off * rule.attraction.weight;
          pull += (velocities[j] - velocity) * rule.alignment.weight;
          const Vec away = shove(rule, off, dot(off, off));
          own.pull += pull;
          own.away += away;
          sums[j].pull -= pull;
          sums[j].away -= away;
          ++seen[j];
        }
        sums[i].pull += own.pull;
        sums[i].away += own.away;
      });
  for (std::size_t i = 0; i < grid.size(); ++i) {
    const std::size_t which = static_cast<std::size_t>(grid.index()[i]);
    Vec sum = sums[i].pull * (seen[i] ? 1.0 / seen[i] : 0.0);
    sum -= sums[i].away * rule.repulsion.weight;
    out[3 * which] = sum.x, out[3 * which + 1] = sum.y, out[3 * which + 2] = sum.z;
    counts[which] = seen[i];
  }
  return looked;
}

// The forces on one member from those it sees among its neighbours.
class Seer {
 public:
  Seer(const Rule& rule, const Neighbours& grid, const Vec* velocities)
      : rule_(rule), grid_(grid), velocities_(velocities) {}

  std::size_t add(std::size_t self, const Vec& here, const Vec& velocity,
                  const std::int32_t* hit, const std::int32_t* end, double* out) {
    look(self, here, velocity, hit, end);
    const double follow = rule_.attraction.radius * rule_.attraction.radius;
    const double align = rule_.alignment.radius * rule_.alignment.radius;
    Vec centre, heading, away;
    double followed = 0, aligned = 0;
    for (const Seen& one : seen_) {
      if (one.squared <= follow) centre += one.off, followed += 1;
      if (one.squared <= align) heading += velocities_[one.at] - velocity, aligned += 1;
      away += shove(rule_, one.off, one.squared);
    }
    Vec sum = centre * (followed > 0 ? rule_.attraction.weight / followed : 0.0);
    sum += heading * (aligned > 0 ? rule_.alignment.weight / aligned : 0.0);
    sum -= away * rule_.repulsion.weight;
    out[0] = sum.x, out[1] = sum.y, out[2] = sum.z;
    return seen_.size();
  }

 private:
  struct Seen {
    Vec off;
    double squared;
    std::size_t at;
  };

  void look(std::size_t self, const Vec& here, const Vec& velocity, const std::int32_t* hit,
            const std::int32_t* end) {
    const double behind = rule_.cosine * std::sqrt(dot(velocity, velocity));
    const std::int32_t* index = grid_.index();
    seen_.clear();
    for (; hit < end; ++hit) {
      const std::size_t j = static_cast<std::size_t>(*hit);
      if (static_cast<std::size_t>(index[j]) == self) continue;
      const Vec off = Vec{grid_.x()[j], grid_.y()[j], grid_.z()[j]} - here;
      const double squared = dot(off, off);
      if (rule_.cosine > -1 && dot(off, velocity) < behind * std::sqrt(squared)) continue;
      seen_.push_back({off, squared, j});
    }
    if (!rule_.nearest || seen_.size() <= rule_.nearest) return;
    // Of two at equal distance the first is taken, whatever the order of the grid.
    const auto nearer = [&](const Seen& a, const Seen& b) {
      return a.squared != b.squared ? a.squared < b.squared : index[a.at] < index[b.at];
    };
    const auto last = seen_.begin() + static_cast<std::ptrdiff_t>(rule_.nearest);
    std::nth_element(seen_.begin(), last - 1, seen_.end(), nearer);
    seen_.erase(last, seen_.end());
    std::sort(seen_.begin(), seen_.end(), nearer);
  }

  const Rule& rule_;
  const Neighbours& grid_;
  const Vec* velocities_;
  std::vector<Seen> seen_;
};

Pull pull(const char* name, const In<double, 1>& pair) {
  check::shape(name, pair, {2});
  check::finite(name, pair);
  check::not_negative(name, pair.data()[1]);
  return {pair.data()[0], pair.data()[1]};
}

}  // namespace

std::tuple<Out<double, 2>, Out<std::int32_t, 1>, double> flock_accelerations(In<double, 2> points, In<double, 2> velocities,
                              std::optional<In<std::int32_t, 1>> members,
                              std::optional<In<std::int32_t, 1>> others, double radius,
                              double cosine, std::int64_t nearest, In<double, 1> attraction,
                              In<double, 1> alignment, In<double, 1> repulsion, double softening,
                              In<double, 2> period, double most) {
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
  const Rule rule{radius,
                  cosine,
                  static_cast<std::size_t>(nearest),
                  pull("attraction", attraction),
                  pull("alignment", alignment),
                  pull("repulsion", repulsion),
                  softening};
  const std::size_t size = members ? members->shape(0) : count;
  Out<double, 2> result(size, 3);
  Out<std::int32_t, 1> counts(size);
  double looked = 0;
  std::fill_n(result.get(), 3 * size, 0.0);
  std::fill_n(counts.get(), size, 0);
  const Neighbours grid(points.data(), others ? others->data() : nullptr,
                        others ? others->shape(0) : count, radius, period.data(), periods);
  const Block<Vec> sorted = block<Vec>(grid.size());
  for (std::size_t i = 0; i < grid.size(); ++i)
    sorted[i] = load(velocities.data() + 3 * static_cast<std::size_t>(grid.index()[i]));
  const bool open = periods[0] == 0 && periods[1] == 0 && periods[2] == 0;
  const bool all = open && !members && !others;
  Seer seer(rule, grid, sorted.get());
  const auto add = [&](std::size_t number, std::size_t which, const Vec& at, const Vec& velocity,
                       const std::int32_t* hit, const std::int32_t* end) {
    const std::size_t seen = seer.add(which, at, velocity, hit, end, result.get() + 3 * number);
    counts.get()[number] = static_cast<std::int32_t>(seen);
  };
  if (all && rule.mutual())
    looked = together(rule, grid, sorted.get(), most, result.get(), counts.get());
  else if (all)
    looked = grid.visit_places<false>(most, [&](std::size_t i, const double* at,
                                                const std::int32_t* hit,
                                                const std::int32_t* end) {
      const std::size_t which = static_cast<std::size_t>(grid.index()[i]);
      add(which, which, load(at), sorted[i], hit, end);
    });
  else
    looked = grid.visit(points.data(), members ? members->data() : nullptr, size, most,
                        [&](std::size_t number, std::size_t which, const double* at,
                            const std::int32_t* hit, const std::int32_t* end) {
                          add(number, which, load(at), load(velocities.data() + 3 * which), hit,
                              end);
                        });
  return {std::move(result), std::move(counts), looked};
}

}  // namespace animtool
