// Edges that pierce triangles.
#include <algorithm>
#include <optional>
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

std::vector<std::int32_t> checked_corners(const char* name, In<std::int64_t, 2> triangles,
                                          std::size_t count) {
  check::shape(name, triangles, {check::ANY, 3});
  check::at_most(name, triangles.shape(0), check::MAX_ROWS);
  check::indices(name, triangles, 0, static_cast<std::int64_t>(count));
  return {triangles.data(), triangles.data() + triangles.size()};
}

}  // namespace

std::int64_t pierced_edges(In<double, 2> positions, In<std::int64_t, 2> triangles,
                           const std::optional<In<std::int64_t, 2>>& others) {
  const std::size_t count = positions.shape(0);
  check::shape("positions", positions, {check::ANY, 3});
  check::at_most("positions", count, check::MAX_ROWS);
  const std::vector<std::int32_t> corners = checked_corners("triangles", triangles, count);
  std::vector<double> x(ROW * count);
  for (std::size_t n = 0; n < count; ++n)
    std::copy_n(positions.data() + 3 * n, 3, x.data() + ROW * n);
  const auto pierced = [&x](const std::vector<std::int32_t>& by,
                            const std::vector<std::int32_t>& in) {
    return static_cast<std::int64_t>(pierced_pairs(x, edges_of(by), in).size());
  };
  if (!others) return pierced(corners, corners);
  const std::vector<std::int32_t> more = checked_corners("others", *others, count);
  return pierced(corners, more) + pierced(more, corners);
}

}  // namespace animtool
