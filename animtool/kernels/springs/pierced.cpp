// Counts edges that intersect triangles.
#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "base/checks.h"
#include "springs/intersections.h"
#include "springs/steps.h"

namespace animtool {

namespace {

// The edges of triangles, as pairs of corners.
std::vector<std::int32_t> collect_edges(const std::vector<std::int32_t>& corners) {
  std::vector<std::pair<std::int32_t, std::int32_t>> edge_pairs;
  for (std::size_t t = 0; t < corners.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k)
      edge_pairs.push_back(std::minmax({corners[t + k], corners[t + (k + 1) % 3]}));
  std::sort(edge_pairs.begin(), edge_pairs.end());
  edge_pairs.erase(std::unique(edge_pairs.begin(), edge_pairs.end()), edge_pairs.end());
  std::vector<std::int32_t> ends;
  for (const auto& [i, j] : edge_pairs) ends.insert(ends.end(), {i, j});
  return ends;
}

// Checks and converts the corners of triangles.
std::vector<std::int32_t> checked_corners(const char* name, In<std::int64_t, 2> triangles,
                                          std::size_t count) {
  check::shape(name, triangles, {check::ANY, 3});
  check::at_most(name, triangles.shape(0), check::MAX_ROWS);
  check::indices(name, triangles, 0, static_cast<std::int64_t>(count));
  return {triangles.data(), triangles.data() + triangles.size()};
}

}  // namespace

std::int64_t pierced_edges(In<double, 2> positions, In<std::int64_t, 2> triangles,
                           const std::optional<In<std::int64_t, 2>>& other_triangles) {
  const std::size_t count = positions.shape(0);
  check::shape("positions", positions, {check::ANY, 3});
  check::at_most("positions", count, check::MAX_ROWS);
  const std::vector<std::int32_t> corners = checked_corners("triangles", triangles, count);
  std::vector<double> x(PARTICLE_STRIDE * count);
  for (std::size_t n = 0; n < count; ++n)
    std::copy_n(positions.data() + 3 * n, 3, x.data() + PARTICLE_STRIDE * n);
  const auto count_intersections = [&x](const std::vector<std::int32_t>& edge_corners,
                                        const std::vector<std::int32_t>& face_corners) {
    return static_cast<std::int64_t>(
        find_intersections(x, collect_edges(edge_corners), face_corners).size());
  };
  if (!other_triangles) return count_intersections(corners, corners);
  const std::vector<std::int32_t> other_corners =
      checked_corners("others", *other_triangles, count);
  return count_intersections(corners, other_corners) + count_intersections(other_corners, corners);
}

}  // namespace animtool
