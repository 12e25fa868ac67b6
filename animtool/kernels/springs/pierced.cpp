// Edges that go through triangles.
#include <algorithm>
#include <utility>
#include <vector>

#include "base/checks.h"
#include "springs/steps.h"
#include "springs/tangles.h"

namespace animtool {

namespace {

std::vector<std::int32_t> edges_of(const std::vector<std::int32_t>& corners) {
  std::vector<std::pair<std::int32_t, std::int32_t>> hit;
  for (std::size_t t = 0; t < corners.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k)
      hit.push_back(std::minmax({corners[t + k], corners[t + (k + 1) % 3]}));
  std::sort(hit.begin(), hit.end());
  hit.erase(std::unique(hit.begin(), hit.end()), hit.end());
  std::vector<std::int32_t> ends;
  for (const auto& [i, j] : hit) ends.insert(ends.end(), {i, j});
  return ends;
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
  return static_cast<std::int64_t>(pierced_pairs(x, edges_of(corners), corners).size());
}

}  // namespace animtool
