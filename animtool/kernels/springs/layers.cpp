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
using shapes::row_of;

// Largest rest distance along the surface of close particles, over the contact distance [1].
constexpr double NEIGHBOURS = 1.5;
// Largest ratio of a path along edges to the straight distance.
constexpr double DETOUR = 2;
// Contact distance of edges, over the thickness: resting layers are supported by their particles
// alone, and edges touch only where ridges would cut into each other.
constexpr double EDGES = 0.75;
constexpr double INFINITE = std::numeric_limits<double>::infinity();

// Neighbours of particles along edges and springs, with path lengths.
class PathLengths {
 public:
  PathLengths(const SpringNetwork& network, const std::vector<double>& rest)
      : adjacent_(network.particles()),
        longest_(network.particles(), 0),
        away_(network.particles(), INFINITE) {
    const auto join = [&](std::int32_t i, std::int32_t j, bool edge) {
      const double shift = length(row_of(rest.data(), i) - row_of(rest.data(), j));
      for (const auto& [from, to] : {std::pair(i, j), std::pair(j, i)}) {
        const std::size_t n = static_cast<std::size_t>(from);
        adjacent_[n].push_back({to, shift});
        if (edge) longest_[n] = std::max(longest_[n], shift);
      }
    };
    const auto& corners = network.triangles;
    for (std::size_t t = 0; t < corners.size(); t += 3)
      for (std::size_t k = 0; k < 3; ++k) join(corners[t + k], corners[t + (k + 1) % 3], true);
    for (const Spring& spring : network.lines.springs) join(spring.i, spring.j, false);
  }

  // Particles within this path length of one, plus its longest edge; ascending.
  const std::vector<std::int32_t>& around(std::int32_t from, double farthest) {
    for (const std::int32_t n : hits_) away(n) = INFINITE;
    hits_.clear();
    farthest += longest_[static_cast<std::size_t>(from)];
    using Shift = std::pair<double, std::int32_t>;
    std::priority_queue<Shift, std::vector<Shift>, std::greater<Shift>> waiting;
    const auto reach = [&](std::int32_t n, double shift) {
      if (shift > farthest || shift >= away(n)) return;
      if (away(n) == INFINITE) hits_.push_back(n);
      away(n) = shift;
      waiting.push({shift, n});
    };
    reach(from, 0);
    while (!waiting.empty()) {
      const auto [shift, n] = waiting.top();
      waiting.pop();
      if (shift > away(n)) continue;
      for (const auto& [next, step] : adjacent_[static_cast<std::size_t>(n)])
        reach(next, shift + step);
    }
    std::sort(hits_.begin(), hits_.end());
    return hits_;
  }

 private:
  double& away(std::int32_t n) { return away_[static_cast<std::size_t>(n)]; }

  std::vector<std::vector<std::pair<std::int32_t, double>>> adjacent_;
  std::vector<double> longest_, away_;
  std::vector<std::int32_t> hits_;
};

}  // namespace

SpringLayers::SpringLayers(const SpringNetwork& network, In<double, 2> rest, double thickness0,
                           double friction0, double speed0)
    : thickness(thickness0),
      friction(friction0),
      speed(speed0),
      particles_(network.particles()),
      corners_(network.triangles),
      adjacent_starts_{0} {
  check::numbers("rest", rest, {particles_, 3});
  check::positive("thickness", thickness);
  check::not_negative("friction", friction);
  check::not_negative("speed", speed);
  rest_.resize(ROW * particles_);
  for (std::size_t n = 0; n < particles_; ++n)
    std::copy_n(rest.data() + 3 * n, 3, rest_.data() + ROW * n);
  collect_edges();
  collect_adjacent(network);
}

void SpringLayers::collect_edges() {
  std::vector<std::pair<std::int32_t, std::int32_t>> hit;
  for (std::size_t t = 0; t < corners_.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k)
      hit.push_back(std::minmax({corners_[t + k], corners_[t + (k + 1) % 3]}));
  std::sort(hit.begin(), hit.end());
  hit.erase(std::unique(hit.begin(), hit.end()), hit.end());
  for (const auto& [i, j] : hit) ends_.insert(ends_.end(), {i, j});
}

void SpringLayers::collect_adjacent(const SpringNetwork& network) {
  PathLengths shifts(network, rest_);
  for (std::size_t n = 0; n < particles_; ++n) {
    const auto& hit = shifts.around(static_cast<std::int32_t>(n), DETOUR * NEIGHBOURS * thickness);
    adjacent_.insert(adjacent_.end(), hit.begin(), hit.end());
    adjacent_starts_.push_back(adjacent_.size());
  }
}

bool SpringLayers::joined(std::int32_t i, std::int32_t j) const {
  const auto from = static_cast<std::size_t>(i);
  return std::binary_search(
      adjacent_.begin() + static_cast<std::ptrdiff_t>(adjacent_starts_[from]),
      adjacent_.begin() + static_cast<std::ptrdiff_t>(adjacent_starts_[from + 1]), j);
}

double SpringLayers::reduced(double at_rest, bool joined) const {
  return std::min(thickness, joined ? at_rest / NEIGHBOURS : at_rest);
}

double SpringLayers::distance(std::size_t triangle, std::int32_t particle) const {
  const std::int32_t* of = corners(triangle);
  if (std::find(of, of + 3, particle) != of + 3) return 0;
  const double gap = shapes::Triangle(of, rest_.data()).distance(row_of(rest_.data(), particle));
  if (!(gap < NEIGHBOURS * thickness)) return thickness;
  return reduced(gap, std::any_of(of, of + 3, [&](std::int32_t n) { return joined(n, particle); }));
}

double SpringLayers::checked_distance(std::int64_t triangle, std::int64_t particle) const {
  check::indices("triangle", &triangle, 1, 0, static_cast<std::int64_t>(triangles()));
  check::indices("particle", &particle, 1, 0, static_cast<std::int64_t>(particles_));
  return distance(static_cast<std::size_t>(triangle), static_cast<std::int32_t>(particle));
}

double SpringLayers::checked_edge_distance(std::int64_t first, std::int64_t second) const {
  check::indices("first", &first, 1, 0, static_cast<std::int64_t>(edges()));
  check::indices("second", &second, 1, 0, static_cast<std::int64_t>(edges()));
  return edge_distance(static_cast<std::size_t>(first), static_cast<std::size_t>(second));
}

double SpringLayers::max_edge_distance() const { return EDGES * thickness; }

double SpringLayers::edge_distance(std::size_t first, std::size_t second) const {
  const std::int32_t *one = ends(first), *other = ends(second);
  const std::int32_t who[4] = {one[0], one[1], other[0], other[1]};
  if (who[0] == who[2] || who[0] == who[3] || who[1] == who[2] || who[1] == who[3]) return 0;
  const double gap = length(shapes::EdgePair(who, rest_.data()).nearest().off);
  if (!(gap < NEIGHBOURS * thickness)) return max_edge_distance();
  const auto relative = [&](std::int32_t n) { return joined(n, who[2]) || joined(n, who[3]); };
  return EDGES * reduced(gap, relative(who[0]) || relative(who[1]));
}

}  // namespace animtool
