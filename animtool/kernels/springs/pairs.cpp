// Broad phase of self-contact, by a grid.
#include "springs/pairs.h"

#include <initializer_list>
#include <limits>
#include <utility>

#include "springs/grid.h"

namespace animtool {

namespace {

using collide::load;
using collide::Vec;
using shapes::position_of;

// A bounding box of points, enlarged by a margin.
struct Box {
  double low[3], high[3];

  Box(std::initializer_list<Vec> points, double margin) {
    std::fill_n(low, 3, std::numeric_limits<double>::infinity());
    std::fill_n(high, 3, -std::numeric_limits<double>::infinity());
    for (const Vec p : points) {
      const double coordinates[3] = {p.x, p.y, p.z};
      for (std::size_t k = 0; k < 3; ++k) {
        low[k] = std::min(low[k], coordinates[k] - margin);
        high[k] = std::max(high[k], coordinates[k] + margin);
      }
    }
  }

  double max_width() const {
    return std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2]});
  }
  // Whether the box overlaps the bounding box of two points.
  bool overlaps(Vec a, Vec b) const {
    return std::max(a.x, b.x) >= low[0] && std::min(a.x, b.x) <= high[0] &&
           std::max(a.y, b.y) >= low[1] && std::min(a.y, b.y) <= high[1] &&
           std::max(a.z, b.z) >= low[2] && std::min(a.z, b.z) <= high[2];
  }
  // Whether it contains a point.
  bool contains(const double* p) const {
    return p[0] >= low[0] && p[0] <= high[0] && p[1] >= low[1] && p[1] <= high[1] &&
           p[2] >= low[2] && p[2] <= high[2];
  }
};

// Builds a grid of points with cells as wide as the mean box: fewer cells are visited than with
// smaller ones, and few more points tested.
void build_grid(PointGrid& grid, const std::vector<double>& rows, double width_sum,
                std::size_t box_count) {
  const double mean = width_sum / static_cast<double>(std::max<std::size_t>(box_count, 1));
  grid.build(rows.data(), rows.size() / PARTICLE_STRIDE, mean);
}

// Sorts pairs by both indices; first indices are below `count`.
void sort_pairs(std::vector<LayerPair>& pairs, std::size_t count) {
  std::vector<std::size_t> starts(count + 1, 0);
  for (const LayerPair& pair : pairs) ++starts[static_cast<std::size_t>(pair.first) + 1];
  for (std::size_t i = 0; i < count; ++i) starts[i + 1] += starts[i];
  std::vector<LayerPair> sorted_pairs(pairs.size());
  std::vector<std::size_t> next(starts.begin(), starts.end() - 1);
  for (const LayerPair& pair : pairs)
    sorted_pairs[next[static_cast<std::size_t>(pair.first)]++] = pair;
  for (std::size_t i = 0; i < count; ++i)
    std::sort(sorted_pairs.begin() + static_cast<std::ptrdiff_t>(starts[i]),
              sorted_pairs.begin() + static_cast<std::ptrdiff_t>(starts[i + 1]),
              [](const LayerPair& a, const LayerPair& b) { return a.second < b.second; });
  pairs = std::move(sorted_pairs);
}

}  // namespace

std::vector<LayerPair> TrianglesAndCorners::find_near(const SpringLayers& layers,
                                                      const std::vector<double>& x, double margin) {
  const double max_gap = layers.thickness + margin;
  const auto triangle_box = [&](const shapes::Triangle& t) {
    return Box({t.a, t.b, t.c}, max_gap);
  };
  double width_sum = 0;
  for (std::size_t t = 0; t < layers.triangle_count(); ++t)
    width_sum += triangle_box(shapes::Triangle(layers.corners(t), x.data())).max_width();
  PointGrid grid;
  build_grid(grid, x, width_sum, layers.triangle_count());
  std::vector<LayerPair> pairs;
  for (std::size_t t = 0; t < layers.triangle_count(); ++t) {
    const std::int32_t* corners = layers.corners(t);
    const shapes::Triangle triangle(corners, x.data());
    const Box bounds = triangle_box(triangle);
    grid.visit(bounds.low, bounds.high, [&](std::int32_t n, const double* position) {
      if (!bounds.contains(position) || std::find(corners, corners + 3, n) != corners + 3) return;
      const double gap = triangle.distance(load(position));
      if (!(gap <= max_gap)) return;
      const double distance = layers.distance(t, n);
      if (distance > 0 && gap - distance <= margin)
        pairs.push_back({static_cast<std::int32_t>(t), n, distance, gap});
    });
  }
  sort_pairs(pairs, layers.triangle_count());
  return pairs;
}

std::vector<LayerPair> EdgesAndEdges::find_near(const SpringLayers& layers,
                                                const std::vector<double>& x, double margin) {
  const double max_gap = layers.max_edge_distance() + margin;
  std::vector<double> midpoints(PARTICLE_STRIDE * layers.edge_count()),
      lengths(layers.edge_count());
  // The longer of two edges finds the shorter one, whose midpoint is in this box.
  const auto edge_box = [&](const shapes::Segment& edge, double edge_length) {
    return Box({edge.a, edge.b}, max_gap + edge_length / 2);
  };
  double width_sum = 0;
  for (std::size_t e = 0; e < layers.edge_count(); ++e) {
    const shapes::Segment edge(layers.ends(e), x.data());
    collide::store(edge.point_at(0.5), &midpoints[PARTICLE_STRIDE * e]);
    lengths[e] = midpoints[PARTICLE_STRIDE * e + 3] = length(edge.vector());
    width_sum += edge_box(edge, lengths[e]).max_width();
  }
  PointGrid grid;
  build_grid(grid, midpoints, width_sum, layers.edge_count());
  std::vector<LayerPair> pairs;
  for (std::size_t e = 0; e < layers.edge_count(); ++e) {
    const std::int32_t* ends = layers.ends(e);
    const shapes::Segment edge(ends, x.data());
    const Box bounds = edge_box(edge, lengths[e]), tight_box = edge_box(edge, 0);
    const Vec midpoint = load(&midpoints[PARTICLE_STRIDE * e]);
    grid.visit(bounds.low, bounds.high, [&](std::int32_t n, const double* position) {
      // The length is stored after the midpoint.
      const double other_length = position[3],
                   max_distance = max_gap + (lengths[e] + other_length) / 2;
      const Vec offset = load(position) - midpoint;
      if (dot(offset, offset) > max_distance * max_distance) return;
      const auto f = static_cast<std::size_t>(n);
      if (!(other_length < lengths[e] || (other_length == lengths[e] && f < e))) return;
      const auto [first, second] = std::minmax(e, f);
      const std::int32_t *first_ends = layers.ends(first), *second_ends = layers.ends(second);
      if (first_ends[0] == second_ends[0] || first_ends[0] == second_ends[1] ||
          first_ends[1] == second_ends[0] || first_ends[1] == second_ends[1])
        return;
      const std::int32_t* other_ends = layers.ends(f);
      if (!tight_box.overlaps(position_of(x.data(), other_ends[0]),
                              position_of(x.data(), other_ends[1])))
        return;
      const std::int32_t particles[4] = {first_ends[0], first_ends[1], second_ends[0],
                                         second_ends[1]};
      const double gap = length(shapes::EdgePair(particles, x.data()).nearest().offset);
      if (!(gap <= max_gap)) return;
      const double distance = layers.edge_distance(first, second);
      if (distance > 0 && gap - distance <= margin)
        pairs.push_back(
            {static_cast<std::int32_t>(first), static_cast<std::int32_t>(second), distance, gap});
    });
  }
  sort_pairs(pairs, layers.edge_count());
  return pairs;
}

}  // namespace animtool
