// Broad phase of self-contact by a grid.
#include "springs/pairs.h"

#include <initializer_list>
#include <limits>
#include <utility>

#include "springs/grid.h"

namespace animtool {

namespace {

using collide::load;
using collide::Vec;
using shapes::row_of;

// A bounding box of points, enlarged by a reach.
struct Box {
  double low[3], high[3];

  Box(std::initializer_list<Vec> points, double reach) {
    std::fill_n(low, 3, std::numeric_limits<double>::infinity());
    std::fill_n(high, 3, -std::numeric_limits<double>::infinity());
    for (const Vec p : points) {
      const double at[3] = {p.x, p.y, p.z};
      for (std::size_t k = 0; k < 3; ++k) {
        low[k] = std::min(low[k], at[k] - reach);
        high[k] = std::max(high[k], at[k] + reach);
      }
    }
  }

  double widest() const { return std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2]}); }
  // Whether it overlaps the bounding box of two points.
  bool overlaps(Vec a, Vec b) const {
    return std::max(a.x, b.x) >= low[0] && std::min(a.x, b.x) <= high[0] &&
           std::max(a.y, b.y) >= low[1] && std::min(a.y, b.y) <= high[1] &&
           std::max(a.z, b.z) >= low[2] && std::min(a.z, b.z) <= high[2];
  }
  bool has(const double* p) const {
    return p[0] >= low[0] && p[0] <= high[0] && p[1] >= low[1] && p[1] <= high[1] &&
           p[2] >= low[2] && p[2] <= high[2];
  }
};

// Builds a grid of points with cells half as wide as the mean box.
void fill(PointGrid& grid, const std::vector<double>& rows, double widths, std::size_t boxes) {
  const double mean = widths / static_cast<double>(std::max<std::size_t>(boxes, 1));
  grid.build(rows.data(), rows.size() / ROW, mean / 2);
}

// Sorts pairs; first indices are below a count.
void sort(std::vector<LayerPair>& pairs, std::size_t count) {
  std::vector<std::size_t> starts(count + 1, 0);
  for (const LayerPair& one : pairs) ++starts[static_cast<std::size_t>(one.first) + 1];
  for (std::size_t i = 0; i < count; ++i) starts[i + 1] += starts[i];
  std::vector<LayerPair> sorted(pairs.size());
  std::vector<std::size_t> next(starts.begin(), starts.end() - 1);
  for (const LayerPair& one : pairs) sorted[next[static_cast<std::size_t>(one.first)]++] = one;
  for (std::size_t i = 0; i < count; ++i)
    std::sort(sorted.begin() + static_cast<std::ptrdiff_t>(starts[i]),
              sorted.begin() + static_cast<std::ptrdiff_t>(starts[i + 1]),
              [](const LayerPair& a, const LayerPair& b) { return a.second < b.second; });
  pairs = std::move(sorted);
}

}  // namespace

std::vector<LayerPair> TrianglesAndCorners::near(const SpringLayers& layers,
                                                 const std::vector<double>& x, double reach) {
  const double max_gap = layers.thickness + reach;
  const auto box = [&](const shapes::Triangle& t) { return Box({t.a, t.b, t.c}, max_gap); };
  double widths = 0;
  for (std::size_t t = 0; t < layers.triangles(); ++t)
    widths += box(shapes::Triangle(layers.corners(t), x.data())).widest();
  PointGrid grid;
  fill(grid, x, widths, layers.triangles());
  std::vector<LayerPair> hit;
  for (std::size_t t = 0; t < layers.triangles(); ++t) {
    const std::int32_t* corners = layers.corners(t);
    const shapes::Triangle triangle(corners, x.data());
    const Box bounds = box(triangle);
    grid.visit(bounds.low, bounds.high, [&](std::int32_t n, const double* location) {
      if (!bounds.has(location) || std::find(corners, corners + 3, n) != corners + 3) return;
      const double gap = triangle.distance(load(location));
      if (!(gap <= max_gap)) return;
      const double distance = layers.distance(t, n);
      if (distance > 0 && gap - distance <= reach)
        hit.push_back({static_cast<std::int32_t>(t), n, distance, gap});
    });
  }
  sort(hit, layers.triangles());
  return hit;
}

std::vector<LayerPair> EdgesAndEdges::near(const SpringLayers& layers, const std::vector<double>& x,
                                           double reach) {
  const double max_gap = layers.max_edge_distance() + reach;
  std::vector<double> middles(ROW * layers.edges()), lengths(layers.edges());
  // The longer of two edges finds the shorter, whose midpoint is within this distance.
  const auto box = [&](const shapes::Segment& edge, double along) {
    return Box({edge.a, edge.b}, max_gap + along / 2);
  };
  double widths = 0;
  for (std::size_t e = 0; e < layers.edges(); ++e) {
    const shapes::Segment edge(layers.ends(e), x.data());
    collide::store(edge.at(0.5), &middles[ROW * e]);
    lengths[e] = middles[ROW * e + 3] = length(edge.shift());
    widths += box(edge, lengths[e]).widest();
  }
  PointGrid grid;
  fill(grid, middles, widths, layers.edges());
  std::vector<LayerPair> hit;
  for (std::size_t e = 0; e < layers.edges(); ++e) {
    const std::int32_t* ends = layers.ends(e);
    const shapes::Segment edge(ends, x.data());
    const Box bounds = box(edge, lengths[e]), close = box(edge, 0);
    const Vec middle = load(&middles[ROW * e]);
    grid.visit(bounds.low, bounds.high, [&](std::int32_t n, const double* location) {
      // The length follows the midpoint.
      const double other = location[3], most = max_gap + (lengths[e] + other) / 2;
      const Vec off = load(location) - middle;
      if (dot(off, off) > most * most) return;
      const auto f = static_cast<std::size_t>(n);
      if (!(other < lengths[e] || (other == lengths[e] && f < e))) return;
      const auto [first, second] = std::minmax(e, f);
      const std::int32_t *one = layers.ends(first), *two = layers.ends(second);
      if (one[0] == two[0] || one[0] == two[1] || one[1] == two[0] || one[1] == two[1]) return;
      const std::int32_t* others = layers.ends(f);
      if (!close.overlaps(row_of(x.data(), others[0]), row_of(x.data(), others[1]))) return;
      const std::int32_t who[4] = {one[0], one[1], two[0], two[1]};
      const double gap = length(shapes::EdgePair(who, x.data()).nearest().off);
      if (!(gap <= max_gap)) return;
      const double distance = layers.edge_distance(first, second);
      if (distance > 0 && gap - distance <= reach)
        hit.push_back(
            {static_cast<std::int32_t>(first), static_cast<std::int32_t>(second), distance, gap});
    });
  }
  sort(hit, layers.edges());
  return hit;
}

}  // namespace animtool
