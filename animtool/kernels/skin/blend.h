// Linear blend skinning of four frames at once. No fused operations, so every processor gives
// the same numbers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "base/wide.h"

namespace animtool {

// Rows of influences: those of vertex v are first[v] to first[v + 1].
struct Influences {
  std::size_t vertices;
  const std::int64_t* first;
  const std::int32_t* joints;
  const double* weights;
};

// Frames that linear blending works on at once.
constexpr std::size_t FRAMES = WIDE;

// Linear blending of several frames, and of one. Both give the same numbers.
struct Blend {
  // Points and results of each frame, (V, 3); the palette has the transforms of the joints,
  // (U, 12), the frames of a number together.
  void (*frames)(const Influences&, const double* palette, const double* const* points,
                 double* const* out);
  // The palette has the columns of the transforms, (U, 4, 4), the last row unused.
  void (*frame)(const Influences&, const double* palette, const double* points, double* out);
};

// For processors that have registers of four doubles; nothing on others.
std::optional<Blend> blend_in_quads();

// Some frames of a table (F, rows, width), the numbers of a place together.
template <std::size_t N>
void interleave(const double* const (&tables)[N], std::size_t count, double* out) {
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t l = 0; l < N; ++l) *out++ = tables[l][i];
}

// Of two frames, for which every processor has registers.
using Pair = Wide<double, 2, Plain>;

// A vector of each of some frames.
template <class N>
Vector3<N> gather(const double* const* frames, std::size_t at) {
  return {N::each([&](std::size_t l) { return frames[l][at]; }),
          N::each([&](std::size_t l) { return frames[l][at + 1]; }),
          N::each([&](std::size_t l) { return frames[l][at + 2]; })};
}
template <std::size_t N, class On>
void scatter(const Vector3<Wide<double, N, On>>& of, double* const* frames, std::size_t at) {
  double x[N], y[N], z[N];
  of.x.store(x), of.y.store(y), of.z.store(z);
  for (std::size_t l = 0; l < N; ++l) {
    double* to = frames[l] + at;
    to[0] = x[l], to[1] = y[l], to[2] = z[l];
  }
}

template <class N>
void blend_frames(const Influences& in, const double* palette, const double* const* points,
                  double* const* out) {
  constexpr std::size_t parts = FRAMES / N::LANES;
  for (std::size_t v = 0; v < in.vertices; ++v) {
    Vector3<N> p[parts], sum[parts];
    for (std::size_t h = 0; h < parts; ++h) p[h] = gather<N>(points + h * N::LANES, 3 * v);
    for (std::int64_t k = in.first[v]; k < in.first[v + 1]; ++k) {
      const N w = in.weights[k];
      const double* a = palette + 12 * FRAMES * in.joints[k];
      for (std::size_t h = 0; h < parts; ++h, a += N::LANES) {
        const N x = w * p[h].x, y = w * p[h].y, z = w * p[h].z;
        const auto row = [&](const double* of) {
          return x * N::of(of) + y * N::of(of + 4) + z * N::of(of + 8) + w * N::of(of + 12);
        };
        sum[h] += Vector3<N>{row(a), row(a + 16), row(a + 32)};
      }
    }
    for (std::size_t h = 0; h < parts; ++h) scatter(sum[h], out + h * N::LANES, 3 * v);
  }
}

template <class On>
void blend_frame(const Influences& in, const double* palette, const double* points, double* out) {
  using N = Four<On>;
  for (std::size_t v = 0; v < in.vertices; ++v, points += 3, out += 3) {
    N sum = 0.0;
    for (std::int64_t k = in.first[v]; k < in.first[v + 1]; ++k) {
      const double w = in.weights[k];
      const double* a = palette + 16 * in.joints[k];
      sum += N(w * points[0]) * N::of(a) + N(w * points[1]) * N::of(a + 4) +
             N(w * points[2]) * N::of(a + 8) + N(w) * N::of(a + 12);
    }
    double row[WIDE];
    sum.store(row);
    for (int i = 0; i < 3; ++i) out[i] = row[i];
  }
}

template <class N, class On>
Blend make_blend() {
  return {blend_frames<N>, blend_frame<On>};
}

}  // namespace animtool
