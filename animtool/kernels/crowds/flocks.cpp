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
  std::size_t max_neighbours;  // 0 means all
  Interaction attraction, alignment, repulsion;
  double softening;

  // Whether all pairs in sight interact symmetrically.
  bool is_mutual() const {
    return !(cosine > -1) && !max_neighbours && attraction.radius >= radius &&
           alignment.radius >= radius;
  }
};

// The offset to another member over its squared length, for repulsion.
Vec find_repulsion(const FlockRule& rule, const Vec& offset, double squared_distance) {
  const bool is_repelled =
      squared_distance <= rule.repulsion.radius * rule.repulsion.radius && squared_distance > 0;
  return offset * (is_repelled ? 1 / (squared_distance + rule.softening * rule.softening) : 0.0);
}

// Adds the forces of symmetric interactions. Each pair is visited once.
double add_mutual_forces(const FlockRule& rule, const Neighbours& grid, const Vec* velocities,
                         double max_tests, double* out, std::int32_t* counts) {
  struct Sums {
    Vec steering, repulsion;
  };
  const Block<Sums> sums = block<Sums>(grid.size());
  std::fill_n(sums.get(), grid.size(), Sums());
  const Block<std::int32_t> sight_counts = block<std::int32_t>(grid.size());
  std::fill_n(sight_counts.get(), grid.size(), 0);
  const double *x = grid.x(), *y = grid.y(), *z = grid.z();
  const double test_count = grid.visit_all<true>(
      max_tests,
      [&](std::size_t i, const double* point, const std::int32_t* hit, const std::int32_t* end) {
        const Vec position = load(point), velocity = velocities[i];
        Sums point_sums;
        sight_counts[i] += static_cast<std::int32_t>(end - hit);
        for (; hit < end; ++hit) {
          const std::size_t j = static_cast<std::size_t>(*hit);
          const Vec offset = Vec{x[j], y[j], z[j]} - position;
          Vec steering = offset * rule.attraction.weight;
          steering += (velocities[j] - velocity) * rule.alignment.weight;
          const Vec repulsion = find_repulsion(rule, offset, dot(offset, offset));
          point_sums.steering += steering;
          point_sums.repulsion += repulsion;
          sums[j].steering -= steering;
          sums[j].repulsion -= repulsion;
          ++sight_counts[j];
        }
        sums[i].steering += point_sums.steering;
        sums[i].repulsion += point_sums.repulsion;
      });
  for (std::size_t i = 0; i < grid.size(); ++i) {
    const std::size_t member = static_cast<std::size_t>(grid.point_indices()[i]);
    Vec sum = sums[i].steering * (sight_counts[i] ? 1.0 / sight_counts[i] : 0.0);
    sum -= sums[i].repulsion * rule.repulsion.weight;
    out[3 * member] = sum.x, out[3 * member + 1] = sum.y, out[3 * member + 2] = sum.z;
    counts[member] = sight_counts[i];
  }
  return test_count;
}

// The forces on one member from those that it sees among its neighbours.
class NeighbourForces {
 public:
  NeighbourForces(const FlockRule& rule, const Neighbours& grid, const Vec* velocities)
      : rule_(rule), grid_(grid), velocities_(velocities) {}

  std::size_t add(std::size_t member, const Vec& position, const Vec& velocity,
                  const std::int32_t* hit, const std::int32_t* end, double* out) {
    find_visible(member, position, velocity, hit, end);
    const double squared_attraction_radius = rule_.attraction.radius * rule_.attraction.radius;
    const double squared_alignment_radius = rule_.alignment.radius * rule_.alignment.radius;
    Vec offset_sum, velocity_sum, repulsion_sum;
    double attraction_count = 0, alignment_count = 0;
    for (const Neighbour& neighbour : neighbours_) {
      if (neighbour.squared_distance <= squared_attraction_radius)
        offset_sum += neighbour.offset, attraction_count += 1;
      if (neighbour.squared_distance <= squared_alignment_radius)
        velocity_sum += velocities_[neighbour.index] - velocity, alignment_count += 1;
      repulsion_sum += find_repulsion(rule_, neighbour.offset, neighbour.squared_distance);
    }
    Vec sum =
        offset_sum * (attraction_count > 0 ? rule_.attraction.weight / attraction_count : 0.0);
    sum += velocity_sum * (alignment_count > 0 ? rule_.alignment.weight / alignment_count : 0.0);
    sum -= repulsion_sum * rule_.repulsion.weight;
    out[0] = sum.x, out[1] = sum.y, out[2] = sum.z;
    return neighbours_.size();
  }

 private:
  struct Neighbour {
    Vec offset;
    double squared_distance;
    std::size_t index;
  };

  void find_visible(std::size_t member, const Vec& position, const Vec& velocity,
                    const std::int32_t* hit, const std::int32_t* end) {
    const double min_projection = rule_.cosine * std::sqrt(dot(velocity, velocity));
    const std::int32_t* index = grid_.point_indices();
    neighbours_.clear();
    for (; hit < end; ++hit) {
      const std::size_t j = static_cast<std::size_t>(*hit);
      if (static_cast<std::size_t>(index[j]) == member) continue;
      const Vec offset = Vec{grid_.x()[j], grid_.y()[j], grid_.z()[j]} - position;
      const double squared_distance = dot(offset, offset);
      if (rule_.cosine > -1 && dot(offset, velocity) < min_projection * std::sqrt(squared_distance))
        continue;
      neighbours_.push_back({offset, squared_distance, j});
    }
    if (!rule_.max_neighbours || neighbours_.size() <= rule_.max_neighbours) return;
    // Of two at equal distance the one with the lower index is first, so that the order of the grid
    // does not matter.
    const auto nearer = [&](const Neighbour& a, const Neighbour& b) {
      return a.squared_distance != b.squared_distance ? a.squared_distance < b.squared_distance
                                                      : index[a.index] < index[b.index];
    };
    const auto end_of_nearest =
        neighbours_.begin() + static_cast<std::ptrdiff_t>(rule_.max_neighbours);
    std::nth_element(neighbours_.begin(), end_of_nearest - 1, neighbours_.end(), nearer);
    neighbours_.erase(end_of_nearest, neighbours_.end());
    std::sort(neighbours_.begin(), neighbours_.end(), nearer);
  }

  const FlockRule& rule_;
  const Neighbours& grid_;
  const Vec* velocities_;
  std::vector<Neighbour> neighbours_;
};

Interaction read_interaction(const char* name, const In<double, 1>& pair) {
  check::shape(name, pair, {2});
  check::finite(name, pair);
  check::non_negative(name, pair.data()[1]);
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
  check::non_negative("softening", softening);
  check::numbers("period", period, {2, 3});
  const double* periods = period.data() + 3;
  for (std::size_t k = 0; k < 3; ++k)
    if (periods[k] != 0 && !(periods[k] >= 2 * radius))
      check::refuse("period", check::text(periods[k]) + " is not 0 or two radii");
  for (const auto* subset : {&members, &others})
    if (*subset)
      check::indices(subset == &members ? "members" : "others", **subset, 0,
                     static_cast<std::int64_t>(count));
  const FlockRule rule{radius,
                       cosine,
                       static_cast<std::size_t>(nearest),
                       read_interaction("attraction", attraction),
                       read_interaction("alignment", alignment),
                       read_interaction("repulsion", repulsion),
                       softening};
  const std::size_t member_count = members ? members->shape(0) : count;
  Out<double, 2> result(member_count, 3);
  Out<std::int32_t, 1> counts(member_count);
  double test_count = 0;
  std::fill_n(result.get(), 3 * member_count, 0.0);
  std::fill_n(counts.get(), member_count, 0);
  const Neighbours grid(points.data(), others ? others->data() : nullptr,
                        others ? others->shape(0) : count, radius, period.data(), periods);
  const Block<Vec> sorted_velocities = block<Vec>(grid.size());
  for (std::size_t i = 0; i < grid.size(); ++i)
    sorted_velocities[i] =
        load(velocities.data() + 3 * static_cast<std::size_t>(grid.point_indices()[i]));
  const bool has_no_period = periods[0] == 0 && periods[1] == 0 && periods[2] == 0;
  const bool visits_all = has_no_period && !members && !others;
  NeighbourForces forces(rule, grid, sorted_velocities.get());
  const auto add = [&](std::size_t row, std::size_t member, const Vec& point, const Vec& velocity,
                       const std::int32_t* hit, const std::int32_t* end) {
    const std::size_t count = forces.add(member, point, velocity, hit, end, result.get() + 3 * row);
    counts.get()[row] = static_cast<std::int32_t>(count);
  };
  if (visits_all && rule.is_mutual())
    test_count = add_mutual_forces(rule, grid, sorted_velocities.get(), max_tests, result.get(),
                                   counts.get());
  else if (visits_all)
    test_count = grid.visit_all<false>(
        max_tests,
        [&](std::size_t i, const double* point, const std::int32_t* hit, const std::int32_t* end) {
          const std::size_t member = static_cast<std::size_t>(grid.point_indices()[i]);
          add(member, member, load(point), sorted_velocities[i], hit, end);
        });
  else
    test_count =
        grid.visit(points.data(), members ? members->data() : nullptr, member_count, max_tests,
                   [&](std::size_t row, std::size_t member, const double* point,
                       const std::int32_t* hit, const std::int32_t* end) {
                     add(row, member, load(point), load(velocities.data() + 3 * member), hit, end);
                   });
  return {std::move(result), std::move(counts), test_count};
}

}  // namespace animtool
