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
  const std::size_t frames = weights.shape(0), count = columns.shape(0);
  check::shape("weights", weights, {check::ANY, check::ANY});
  check::shape("points", points, {points.shape(0) == 1 ? 1 : frames, check::ANY, 3});
  check::shape("first", first, {points.shape(1) + 1});
  check::shape("columns", columns, {check::ANY});
  check::shape("offsets", offsets, {count, 3});
  check::starts("first", first, count);
  check::at_most("weights", weights.shape(1), check::MAX_ROWS);
  check::indices("columns", columns, 0, static_cast<std::int64_t>(weights.shape(1)));
}

void add_offsets(std::size_t vertices, const std::int64_t* first, const std::int32_t* columns,
                 const double* offsets, const double* weights, const double* const (&from)[FRAMES],
                 double* const (&to)[FRAMES]) {
  for (std::size_t v = 0; v < vertices; ++v) {
    // All frames are read before any is written: the last may be listed twice.
    Vector3<Pair> p[2] = {gather<Pair>(from, 3 * v), gather<Pair>(from + 2, 3 * v)};
    for (std::int64_t k = first[v]; k < first[v + 1]; ++k)
      for (int h = 0; h < 2; ++h)
        p[h] += Vector3<Pair>::broadcast(offsets + 3 * k) *
                Pair::of(weights + FRAMES * columns[k] + 2 * h);
    for (int h = 0; h < 2; ++h) scatter(p[h], to + 2 * h, 3 * v);
  }
}

// One frame, without the columns of weight 0.
void add_frame(std::size_t vertices, const std::int64_t* first, const std::int32_t* columns,
               const double* offsets, const double* weights, const double* from, double* to) {
  for (std::size_t v = 0; v < vertices; ++v, from += 3, to += 3) {
    Vec p = load(from);
    for (std::int64_t k = first[v]; k < first[v + 1]; ++k) {
      const double weight = weights[columns[k]];
      if (weight != 0) p += load(offsets + 3 * k) * weight;
    }
    store(p, to);
  }
}

}  // namespace

void add_sparse(In<double, 3> points, In<double, 2> weights, In<std::int64_t, 1> first,
                In<std::int32_t, 1> columns, In<double, 2> offsets, Filled<double, 3> out) {
  check_offsets(points, weights, first, columns, offsets);
  const std::size_t frames = weights.shape(0), shapes = weights.shape(1);
  const std::size_t vertices = points.shape(1), row = vertices * 3;
  check::shape("out", out, {frames, vertices, 3});
  const std::size_t stride = points.shape(0) == 1 ? 0 : row;
  if (frames == 1) {
    add_frame(vertices, first.data(), columns.data(), offsets.data(), weights.data(), points.data(),
              out.data());
    return;
  }
  std::vector<double> table(shapes * FRAMES);
  for (std::size_t f = 0; f < frames; f += FRAMES) {
    const double *rows[FRAMES], *from[FRAMES];
    double* to[FRAMES];
    for (std::size_t l = 0; l < FRAMES; ++l) {
      const std::size_t g = std::min(f + l, frames - 1);
      rows[l] = weights.data() + g * shapes;
      from[l] = points.data() + g * stride;
      to[l] = out.data() + g * row;
    }
    interleave(rows, shapes, table.data());
    add_offsets(vertices, first.data(), columns.data(), offsets.data(), table.data(), from, to);
  }
}

Out<double, 3> point_extents(In<double, 3> points) {
  const std::size_t frames = points.shape(0), vertices = points.shape(1);
  check::shape("points", points, {check::ANY, check::ANY, 3});
  Out<double, 3> result(frames, 2, 3);
  const double* p = points.data();
  for (std::size_t f = 0; f < frames; ++f) {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    double low[3] = {infinity, infinity, infinity};
    double high[3] = {-infinity, -infinity, -infinity};
    for (std::size_t v = 0; v < vertices; ++v, p += 3)
      for (int i = 0; i < 3; ++i) {
        low[i] = p[i] < low[i] ? p[i] : low[i];
        high[i] = p[i] > high[i] ? p[i] : high[i];
      }
    std::copy_n(low, 3, result.get() + 6 * f);
    std::copy_n(high, 3, result.get() + 6 * f + 3);
  }
  return result;
}

}  // namespace animtool
