// Contact distances within a surface.
#include "springs/layers.h"

#include <algorithm>
#include <limits>
#include <queue>

#include "base/checks.h"
#include "springs/shapes.h"

namespace animtool {

namespace {

using collide::Vec;
using shapes::position_of;

// Largest rest distance along the surface of adjacent particles, over the contact distance [1].
constexpr double ADJACENT_RATIO = 1.5;
// Largest ratio of a path along edges to the straight distance.
constexpr double MAX_DETOUR_RATIO = 2;
// Contact distance of edges, over the thickness: resting layers are supported by their particles
// only, and edges touch only where ridges would cut into each other.
constexpr double EDGE_THICKNESS_FACTOR = 0.75;
// Rest distances that are larger than a limit by this factor are so despite rounding [1].
constexpr double ROUNDING_FACTOR = 1 + 1e-9;
constexpr double INF = std::numeric_limits<double>::infinity();

// Shortest path lengths between particles along edges and springs.
class PathLengths {
 public:
  PathLengths(const SpringNetwork& network, const std::vector<double>& rest_positions)
      : neighbours_(network.particle_count()),
        longest_edges_(network.particle_count(), 0),
        path_lengths_(network.particle_count(), INF) {
    const auto add_link = [&](std::int32_t i, std::int32_t j, bool is_edge) {
      const double link_length =
          length(position_of(rest_positions.data(), i) - position_of(rest_positions.data(), j));
      for (const auto& [from, to] : {std::pair(i, j), std::pair(j, i)}) {
        const std::size_t n = static_cast<std::size_t>(from);
        neighbours_[n].push_back({to, link_length});
        if (is_edge) longest_edges_[n] = std::max(longest_edges_[n], link_length);
      }
    };
    const auto& corners = network.triangles;
    for (std::size_t t = 0; t < corners.size(); t += 3)
      for (std::size_t k = 0; k < 3; ++k) add_link(corners[t + k], corners[t + (k + 1) % 3], true);
    for (const Spring& spring : network.spring_set.springs) add_link(spring.i, spring.j, false);
  }

  // Particles within a path length of one, plus its longest edge; ascending.
  const std::vector<std::int32_t>& find_within(std::int32_t from, double max_length) {
    for (const std::int32_t n : near_particles_) path_length(n) = INF;
    near_particles_.clear();
    max_length += longest_edges_[static_cast<std::size_t>(from)];
    using QueueEntry = std::pair<double, std::int32_t>;
    std::priority_queue<QueueEntry, std::vector<QueueEntry>, std::greater<QueueEntry>> queue;
    const auto visit = [&](std::int32_t n, double distance) {
      if (distance > max_length || distance >= path_length(n)) return;
      if (path_length(n) == INF) near_particles_.push_back(n);
      path_length(n) = distance;
      queue.push({distance, n});
    };
    visit(from, 0);
    while (!queue.empty()) {
      const auto [distance, n] = queue.top();
      queue.pop();
      if (distance > path_length(n)) continue;
      for (const auto& [next, link_length] : neighbours_[static_cast<std::size_t>(n)])
        visit(next, distance + link_length);
    }
    std::sort(near_particles_.begin(), near_particles_.end());
    return near_particles_;
  }

 private:
  double& path_length(std::int32_t n) { return path_lengths_[static_cast<std::size_t>(n)]; }

  std::vector<std::vector<std::pair<std::int32_t, double>>> neighbours_;
  std::vector<double> longest_edges_, path_lengths_;
  std::vector<std::int32_t> near_particles_;
};

}  // namespace

SpringLayers::SpringLayers(const SpringNetwork& network, In<double, 2> rest_positions,
                           double thickness0, double friction0, double separation_speed0)
    : thickness(thickness0),
      friction(friction0),
      separation_speed(separation_speed0),
      particles_(network.particle_count()),
      corners_(network.triangles),
      adjacent_particle_starts_{0} {
  check::numbers("rest_positions", rest_positions, {particles_, 3});
  check::positive("thickness", thickness);
  check::non_negative("friction", friction);
  check::non_negative("separation_speed", separation_speed);
  rest_positions_.resize(PARTICLE_STRIDE * particles_);
  for (std::size_t n = 0; n < particles_; ++n)
    std::copy_n(rest_positions.data() + 3 * n, 3, rest_positions_.data() + PARTICLE_STRIDE * n);
  collect_edges();
  collect_adjacent_particles(network);
}

void SpringLayers::collect_edges() {
  std::vector<std::pair<std::int32_t, std::int32_t>> edge_pairs;
  for (std::size_t t = 0; t < corners_.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k)
      edge_pairs.push_back(std::minmax({corners_[t + k], corners_[t + (k + 1) % 3]}));
  std::sort(edge_pairs.begin(), edge_pairs.end());
  edge_pairs.erase(std::unique(edge_pairs.begin(), edge_pairs.end()), edge_pairs.end());
  for (const auto& [i, j] : edge_pairs) ends_.insert(ends_.end(), {i, j});
}

void SpringLayers::collect_adjacent_particles(const SpringNetwork& network) {
  PathLengths path_lengths(network, rest_positions_);
  for (std::size_t n = 0; n < particles_; ++n) {
    const auto& adjacent_particles = path_lengths.find_within(
        static_cast<std::int32_t>(n), MAX_DETOUR_RATIO * ADJACENT_RATIO * thickness);
    adjacent_particles_.insert(adjacent_particles_.end(), adjacent_particles.begin(),
                               adjacent_particles.end());
    adjacent_particle_starts_.push_back(adjacent_particles_.size());
  }
}

bool SpringLayers::is_adjacent(std::int32_t i, std::int32_t j) const {
  const auto from = static_cast<std::size_t>(i);
  return std::binary_search(
      adjacent_particles_.begin() + static_cast<std::ptrdiff_t>(adjacent_particle_starts_[from]),
      adjacent_particles_.begin() +
          static_cast<std::ptrdiff_t>(adjacent_particle_starts_[from + 1]),
      j);
}

double SpringLayers::contact_distance(double rest_gap, bool is_adjacent) const {
  return std::min(thickness, is_adjacent ? rest_gap / ADJACENT_RATIO : rest_gap);
}

double SpringLayers::distance(std::size_t triangle, std::int32_t particle) const {
  const std::int32_t* triangle_corners = corners(triangle);
  if (std::find(triangle_corners, triangle_corners + 3, particle) != triangle_corners + 3) return 0;
  const double rest_gap = shapes::Triangle(triangle_corners, rest_positions_.data())
                              .distance(position_of(rest_positions_.data(), particle));
  if (!(rest_gap < ADJACENT_RATIO * thickness)) return thickness;
  return contact_distance(rest_gap,
                          std::any_of(triangle_corners, triangle_corners + 3,
                                      [&](std::int32_t n) { return is_adjacent(n, particle); }));
}

double SpringLayers::checked_distance(std::int64_t triangle, std::int64_t particle) const {
  check::indices("triangle", &triangle, 1, 0, static_cast<std::int64_t>(triangle_count()));
  check::indices("particle", &particle, 1, 0, static_cast<std::int64_t>(particles_));
  return distance(static_cast<std::size_t>(triangle), static_cast<std::int32_t>(particle));
}

double SpringLayers::checked_edge_distance(std::int64_t first, std::int64_t second) const {
  check::indices("first", &first, 1, 0, static_cast<std::int64_t>(edge_count()));
  check::indices("second", &second, 1, 0, static_cast<std::int64_t>(edge_count()));
  return edge_distance(static_cast<std::size_t>(first), static_cast<std::size_t>(second));
}

double SpringLayers::max_edge_distance() const { return EDGE_THICKNESS_FACTOR * thickness; }

double SpringLayers::edge_distance(std::size_t first, std::size_t second) const {
  const std::int32_t *first_ends = ends(first), *second_ends = ends(second);
  const std::int32_t particles[4] = {first_ends[0], first_ends[1], second_ends[0], second_ends[1]};
  if (particles[0] == particles[2] || particles[0] == particles[3] ||
      particles[1] == particles[2] || particles[1] == particles[3])
    return 0;
  // Most edges that meet in folds are far apart at rest: the spheres around them show it.
  const shapes::Segment first_edge(first_ends, rest_positions_.data()),
      second_edge(second_ends, rest_positions_.data());
  const Vec midpoint_offset = first_edge.point_at(0.5) - second_edge.point_at(0.5);
  const double max_distance = (ADJACENT_RATIO * thickness +
                               (length(first_edge.vector()) + length(second_edge.vector())) / 2) *
                              ROUNDING_FACTOR;
  if (dot(midpoint_offset, midpoint_offset) > max_distance * max_distance)
    return max_edge_distance();
  const double rest_gap =
      length(shapes::EdgePair(particles, rest_positions_.data()).nearest().offset);
  if (!(rest_gap < ADJACENT_RATIO * thickness)) return max_edge_distance();
  const auto is_adjacent_to_second = [&](std::int32_t n) {
    return is_adjacent(n, particles[2]) || is_adjacent(n, particles[3]);
  };
  return EDGE_THICKNESS_FACTOR *
         contact_distance(
             rest_gap, is_adjacent_to_second(particles[0]) || is_adjacent_to_second(particles[1]));
}

}  // namespace animtool
