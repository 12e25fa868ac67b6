// Linear blend skinning of four frames at once, written for registers of any width. No
// fused operations, so every width gives the same numbers.
#pragma once

#include <cstddef>
#include <cstdint>

namespace animtool {

// Rows of influences: those of vertex v are first[v] to first[v + 1].
struct Influences {
  std::size_t vertices;
  const std::int64_t* first;
  const std::int32_t* joints;
  const double* weights;
};

// Frames that linear blending works on at once.
constexpr std::size_t FRAMES = 4;

// Points and results of each frame, (V, 3); the palette has the transforms of the joints,
// (U, 12), the frames of a number together.
using BlendFrames = void (*)(const Influences&, const double* palette,
                             const double* const* points, double* const* out);

// For processors that have registers of four doubles; null on others.
BlendFrames blend_in_quads(bool still);

// Nothing here is shared between source files, which are built for other processors.
namespace {

template <typename Lanes>
struct Lane {
  Lanes x, y, z;
};

// Still points share the products with their weights between all frames.
template <typename Registers, bool Still>
void blend_frames(const Influences& in, const double* palette, const double* const* points,
                  double* const* out) {
  using Lanes = typename Registers::Lanes;
  constexpr std::size_t lanes = sizeof(Lanes) / sizeof(double), parts = FRAMES / lanes;
  const auto fetch = [](const double* from) { return Registers::fetch(from); };
  for (std::size_t v = 0; v < in.vertices; ++v) {
    Lane<Lanes> p[parts], sum[parts] = {};
    for (std::size_t h = 0; h < parts; ++h) {
      const double* const* rows = points + h * lanes;
      p[h] = {Registers::gather(rows, 3 * v), Registers::gather(rows, 3 * v + 1),
              Registers::gather(rows, 3 * v + 2)};
    }
    for (std::int64_t k = in.first[v]; k < in.first[v + 1]; ++k) {
      const Lanes w = Registers::spread(in.weights[k]);
      const double* a = palette + 12 * FRAMES * in.joints[k];
      for (std::size_t h = 0; h < parts; ++h, a += lanes) {
        const Lane<Lanes>& q = p[Still ? 0 : h];
        const Lanes x = w * q.x, y = w * q.y, z = w * q.z;
        sum[h].x += x * fetch(a) + y * fetch(a + 4) + z * fetch(a + 8) + w * fetch(a + 12);
        sum[h].y +=
            x * fetch(a + 16) + y * fetch(a + 20) + z * fetch(a + 24) + w * fetch(a + 28);
        sum[h].z +=
            x * fetch(a + 32) + y * fetch(a + 36) + z * fetch(a + 40) + w * fetch(a + 44);
      }
    }
    for (std::size_t h = 0; h < parts; ++h)
      for (std::size_t l = 0; l < lanes; ++l) {
        double* to = out[h * lanes + l] + 3 * v;
        to[0] = sum[h].x[l], to[1] = sum[h].y[l], to[2] = sum[h].z[l];
      }
  }
}

}  // namespace

}  // namespace animtool
