// Sums of sparse blend shapes over frames, and the bounds of points.
#include <algorithm>
#include <limits>
#include <vector>

#include "base/checks.h"
#include "skin/blend.h"
#include "skin/skin.h"

namespace animtool {

namespace {

void check_offsets(const In<double, 3>& points, const In<double, 2>& weights,
                   const In<std::int64_t, 1>& first, const In<std::int32_t, 1>& columns,
                   const In<double, 2>& offsets) {
  const std::size_t frames = weights.shape(0), offset_count = columns.shape(0);
  check::shape("weights", weights, {check::ANY, check::ANY});
  check::shape("points", points, {points.shape(0) == 1 ? 1 : frames, check::ANY, 3});
  check::shape("first", first, {points.shape(1) + 1});
  check::shape("columns", columns, {check::ANY});
  check::shape("offsets", offsets, {offset_count, 3});
  check::starts("first", first, offset_count);
  check::at_most("weights", weights.shape(1), check::MAX_ROWS);
  check::indices("columns", columns, 0, static_cast<std::int64_t>(weights.shape(1)));
}

void add_offsets(std::size_t vertices, const std::int64_t* first, const std::int32_t* columns,
                 const double* offsets, const double* weights,
                 const double* const (&sources)[FRAMES_AT_ONCE],
                 double* const (&targets)[FRAMES_AT_ONCE]) {
  for (std::size_t vertex = 0; vertex < vertices; ++vertex) {
    // All frames are read before any is written, because the last frame may be listed twice.
    Vector3<FramePair> sums[2] = {gather<FramePair>(sources, 3 * vertex),
                                  gather<FramePair>(sources + 2, 3 * vertex)};
    for (std::int64_t entry = first[vertex]; entry < first[vertex + 1]; ++entry)
      for (int group = 0; group < 2; ++group)
        sums[group] += Vector3<FramePair>::broadcast(offsets + 3 * entry) *
                       FramePair::load(weights + FRAMES_AT_ONCE * columns[entry] + 2 * group);
    for (int group = 0; group < 2; ++group) scatter(sums[group], targets + 2 * group, 3 * vertex);
  }
}

// Adds the offsets of one frame. Skips columns of weight 0.
void add_frame(std::size_t vertices, const std::int64_t* first, const std::int32_t* columns,
               const double* offsets, const double* weights, const double* source, double* target) {
  for (std::size_t vertex = 0; vertex < vertices; ++vertex, source += 3, target += 3) {
    Vec point = load(source);
    for (std::int64_t entry = first[vertex]; entry < first[vertex + 1]; ++entry) {
      const double weight = weights[columns[entry]];
      if (weight != 0) point += load(offsets + 3 * entry) * weight;
    }
    store(point, target);
  }
}

}  // namespace

void add_sparse(In<double, 3> points, In<double, 2> weights, In<std::int64_t, 1> first,
                In<std::int32_t, 1> columns, In<double, 2> offsets, Filled<double, 3> out) {
  check_offsets(points, weights, first, columns, offsets);
  const std::size_t frames = weights.shape(0), shapes = weights.shape(1);
  const std::size_t vertices = points.shape(1), row_size = vertices * 3;
  check::shape("out", out, {frames, vertices, 3});
  const std::size_t points_stride = points.shape(0) == 1 ? 0 : row_size;
  if (frames == 1) {
    add_frame(vertices, first.data(), columns.data(), offsets.data(), weights.data(), points.data(),
              out.data());
    return;
  }
  std::vector<double> weight_table(shapes * FRAMES_AT_ONCE);
  for (std::size_t f = 0; f < frames; f += FRAMES_AT_ONCE) {
    const double *weight_rows[FRAMES_AT_ONCE], *sources[FRAMES_AT_ONCE];
    double* targets[FRAMES_AT_ONCE];
    for (std::size_t i = 0; i < FRAMES_AT_ONCE; ++i) {
      const std::size_t frame = std::min(f + i, frames - 1);
      weight_rows[i] = weights.data() + frame * shapes;
      sources[i] = points.data() + frame * points_stride;
      targets[i] = out.data() + frame * row_size;
    }
    interleave(weight_rows, shapes, weight_table.data());
    add_offsets(vertices, first.data(), columns.data(), offsets.data(), weight_table.data(),
                sources, targets);
  }
}

Out<double, 3> point_extents(In<double, 3> points) {
  const std::size_t frames = points.shape(0), vertices = points.shape(1);
  check::shape("points", points, {check::ANY, check::ANY, 3});
  Out<double, 3> result(frames, 2, 3);
  const double* point = points.data();
  for (std::size_t frame = 0; frame < frames; ++frame) {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    double low[3] = {infinity, infinity, infinity};
    double high[3] = {-infinity, -infinity, -infinity};
    for (std::size_t vertex = 0; vertex < vertices; ++vertex, point += 3)
      for (int i = 0; i < 3; ++i) {
        low[i] = point[i] < low[i] ? point[i] : low[i];
        high[i] = point[i] > high[i] ? point[i] : high[i];
      }
    std::copy_n(low, 3, result.get() + 6 * frame);
    std::copy_n(high, 3, result.get() + 6 * frame + 3);
  }
  return result;
}

}  // namespace animtool
