// Edges that go through triangles.
#include <algorithm>
#include <utility>
#include <vector>

#include "base/checks.h"
#include "springs/grid.h"
#include "springs/shapes.h"
#include "springs/steps.h"

namespace animtool {

namespace {

using collide::Vec;

// Whether the ends of an edge are on both sides of a triangle, and it is between its sides.
bool pierces(const shapes::Segment& edge, const shapes::Triangle& t) {
  const Vec normal = cross(t.b - t.a, t.c - t.a);
  const double first = dot(edge.a - t.a, normal), last = dot(edge.b - t.a, normal);
  if (!(first * last < 0)) return false;
  const Vec at = edge.at(first / (first - last));
  const auto left = [&](Vec from, Vec to) { return dot(cross(to - from, at - from), normal) > 0; };
  return left(t.a, t.b) && left(t.b, t.c) && left(t.c, t.a);
}

std::vector<std::pair<std::int32_t, std::int32_t>> edges_of(
    const std::vector<std::int32_t>& corners) {
  std::vector<std::pair<std::int32_t, std::int32_t>> found;
  for (std::size_t t = 0; t < corners.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k)
      found.push_back(std::minmax({corners[t + k], corners[t + (k + 1) % 3]}));
  std::sort(found.begin(), found.end());
  found.erase(std::unique(found.begin(), found.end()), found.end());
  return found;
}

std::int64_t count_pierced(const std::vector<double>& x,
                           const std::vector<std::int32_t>& corners) {
  const auto edges = edges_of(corners);
  std::vector<double> middles(ROW * edges.size());
  double longest = 0, lengths = 0;
  const auto segment = [&](std::size_t e) {
    return shapes::Segment(shapes::row_of(x.data(), edges[e].first),
                           shapes::row_of(x.data(), edges[e].second));
  };
  for (std::size_t e = 0; e < edges.size(); ++e) {
    collide::store(segment(e).at(0.5), &middles[ROW * e]);
    const double own = length(segment(e).way());
    longest = std::max(longest, own), lengths += own;
  }
  if (!(lengths > 0)) return 0;
  PointGrid grid;
  grid.build(middles.data(), edges.size(), lengths / static_cast<double>(edges.size()));
  std::int64_t count = 0;
  for (std::size_t t = 0; t < corners.size(); t += 3) {
    const shapes::Triangle triangle(&corners[t], x.data());
    double low[3], high[3];
    for (std::size_t k = 0; k < 3; ++k) {
      const auto at = [&](std::size_t i) {
        return x[ROW * static_cast<std::size_t>(corners[t + i]) + k];
      };
      low[k] = std::min({at(0), at(1), at(2)}) - longest / 2;
      high[k] = std::max({at(0), at(1), at(2)}) + longest / 2;
    }
    grid.visit(low, high, [&](std::int32_t e, const double*) {
      const auto [i, j] = edges[static_cast<std::size_t>(e)];
      for (std::size_t k = t; k < t + 3; ++k)
        if (corners[k] == i || corners[k] == j) return;
      count += pierces(segment(static_cast<std::size_t>(e)), triangle);
    });
  }
  return count;
}

}  // namespace

std::int64_t pierced_edges(In<double, 2> positions, In<std::int64_t, 2> triangles) {
  const std::size_t count = positions.shape(0);
  check::shape("positions", positions, {check::ANY, 3});
  check::at_most("positions", count, check::MOST_ROWS);
  check::shape("triangles", triangles, {check::ANY, 3});
  check::at_most("triangles", triangles.shape(0), check::MOST_ROWS);
  check::indices("triangles", triangles, 0, static_cast<std::int64_t>(count));
  std::vector<double> x(ROW * count);
  for (std::size_t n = 0; n < count; ++n)
    std::copy_n(positions.data() + 3 * n, 3, x.data() + ROW * n);
  const std::vector<std::int32_t> corners(triangles.data(), triangles.data() + triangles.size());
  return count_pierced(x, corners);
}

}  // namespace animtool
