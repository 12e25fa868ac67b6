// Linear blend skinning of four frames at once. It uses no fused operations, so every processor
// computes the same numbers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "base/wide.h"

namespace animtool {

// Rows of influences. Those of vertex v are first[v] to first[v + 1].
struct Influences {
  std::size_t vertices;
  const std::int64_t* first;
  const std::int32_t* joints;
  const double* weights;
};

// Number of frames that linear blending processes at once.
constexpr std::size_t FRAMES_AT_ONCE = SIMD_WIDTH;

// Linear blending of several frames, and of one frame. Both compute the same numbers.
struct BlendFunctions {
  // Points and results of each frame are (V, 3). The palette contains the transforms of the joints
  // (U, 12). Each number is stored for all frames consecutively.
  void (*blend_frames)(const Influences&, const double* palette, const double* const* points,
                       double* const* out);
  // The palette contains the columns of the transforms (U, 4, 4). The last row is unused.
  void (*blend_frame)(const Influences&, const double* palette, const double* points, double* out);
};

// For processors that have registers of four doubles. Nothing on other processors.
std::optional<BlendFunctions> blend_in_quads();

// Interleaves some frames of a table, so that each number is stored for all frames consecutively.
template <std::size_t N>
void interleave(const double* const (&tables)[N], std::size_t count, double* out) {
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t table = 0; table < N; ++table) *out++ = tables[table][i];
}

// Two frames at once. Every processor has registers for them.
using FramePair = Wide<double, 2, Portable>;

// Reads one vector from each of several frames.
template <class Values>
Vector3<Values> gather(const double* const* frames, std::size_t offset) {
  return {Values::generate([&](std::size_t i) { return frames[i][offset]; }),
          Values::generate([&](std::size_t i) { return frames[i][offset + 1]; }),
          Values::generate([&](std::size_t i) { return frames[i][offset + 2]; })};
}
template <std::size_t Values, class Simd>
void scatter(const Vector3<Wide<double, Values, Simd>>& vectors, double* const* frames,
             std::size_t offset) {
  double x[Values], y[Values], z[Values];
  vectors.x.store(x), vectors.y.store(y), vectors.z.store(z);
  for (std::size_t i = 0; i < Values; ++i) {
    double* target = frames[i] + offset;
    target[0] = x[i], target[1] = y[i], target[2] = z[i];
  }
}

template <class Values>
void blend_frames(const Influences& influences, const double* palette, const double* const* points,
                  double* const* out) {
  constexpr std::size_t group_count = FRAMES_AT_ONCE / Values::LANES;
  for (std::size_t vertex = 0; vertex < influences.vertices; ++vertex) {
    Vector3<Values> vertex_points[group_count], sums[group_count];
    for (std::size_t group = 0; group < group_count; ++group)
      vertex_points[group] = gather<Values>(points + group * Values::LANES, 3 * vertex);
    for (std::int64_t influence = influences.first[vertex];
         influence < influences.first[vertex + 1]; ++influence) {
      const Values weight = influences.weights[influence];
      const double* transform = palette + 12 * FRAMES_AT_ONCE * influences.joints[influence];
      for (std::size_t group = 0; group < group_count; ++group, transform += Values::LANES) {
        const Values weighted_x = weight * vertex_points[group].x,
                     weighted_y = weight * vertex_points[group].y,
                     weighted_z = weight * vertex_points[group].z;
        const auto row = [&](const double* column) {
          return weighted_x * Values::load(column) + weighted_y * Values::load(column + 4) +
                 weighted_z * Values::load(column + 8) + weight * Values::load(column + 12);
        };
        sums[group] += Vector3<Values>{row(transform), row(transform + 16), row(transform + 32)};
      }
    }
    for (std::size_t group = 0; group < group_count; ++group)
      scatter(sums[group], out + group * Values::LANES, 3 * vertex);
  }
}

template <class Simd>
void blend_frame(const Influences& influences, const double* palette, const double* points,
                 double* out) {
  using Values = Four<Simd>;
  for (std::size_t vertex = 0; vertex < influences.vertices; ++vertex, points += 3, out += 3) {
    Values sum = 0.0;
    for (std::int64_t influence = influences.first[vertex];
         influence < influences.first[vertex + 1]; ++influence) {
      const double weight = influences.weights[influence];
      const double* transform = palette + 16 * influences.joints[influence];
      sum += Values(weight * points[0]) * Values::load(transform) +
             Values(weight * points[1]) * Values::load(transform + 4) +
             Values(weight * points[2]) * Values::load(transform + 8) +
             Values(weight) * Values::load(transform + 12);
    }
    double row[SIMD_WIDTH];
    sum.store(row);
    for (int i = 0; i < 3; ++i) out[i] = row[i];
  }
}

template <class N, class Simd>
BlendFunctions make_blend_functions() {
  return {blend_frames<N>, blend_frame<Simd>};
}

}  // namespace animtool
