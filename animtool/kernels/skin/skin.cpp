// Skinning: linear blend and dual quaternions, several frames at a time.
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/checks.h"
#include "skin/blend.h"
#include "skin/skin.h"

namespace animtool {

namespace {

Influences influences_of(const In<std::int64_t, 1>& first, const In<std::int32_t, 1>& joints,
                         const In<double, 1>& weights, std::size_t joint_count) {
  const std::size_t count = joints.shape(0);
  check::shape("first", first, {check::ANY});
  check::shape("joints", joints, {check::ANY});
  check::shape("weights", weights, {count});
  check::starts("first", first, count);
  check::indices("joints", joints, 0, static_cast<std::int64_t>(joint_count));
  return {first.shape(0) - 1, first.data(), joints.data(), weights.data()};
}

// Points of one frame for all, or of each frame.
class Points {
 public:
  Points(const In<double, 3>& points, std::size_t frames, std::size_t vertices)
      : data_(points.data()), stride_(points.shape(0) == 1 ? 0 : vertices * 3) {
    check::shape("points", points, {points.shape(0) == 1 ? 1 : frames, vertices, 3});
  }
  const double* frame(std::size_t f) const { return data_ + f * stride_; }

 private:
  const double* data_;
  std::size_t stride_;
};

inline void unit(double* v) {
  const double squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
  if (!(squared > 0)) return;
  const double length = std::sqrt(squared);
  for (int i = 0; i < 3; ++i) v[i] /= length;
}

// Rotation x y z w, then the dual part x y z w, of each joint.
void dual_quaternions(const double* q, const double* t, std::size_t joints, double* out) {
  for (std::size_t j = 0; j < joints; ++j, q += 4, t += 3, out += 8) {
    std::copy_n(q, 4, out);
    out[4] = 0.5 * (q[3] * t[0] + t[1] * q[2] - t[2] * q[1]);
    out[5] = 0.5 * (q[3] * t[1] + t[2] * q[0] - t[0] * q[2]);
    out[6] = 0.5 * (q[3] * t[2] + t[0] * q[1] - t[1] * q[0]);
    out[7] = -0.5 * (t[0] * q[0] + t[1] * q[1] + t[2] * q[2]);
  }
}

// A shorter blended quaternion rotates nothing, as in UsdSkel.
constexpr double SHORTEST = 1e-10;

// Of two frames: more would not stay in registers.
template <bool Stretched>
void dual_frames(const Influences& in, const double* palette, const double* stretches,
                 const double* const (&points)[2], double* const (&out)[2], bool normalize) {
  for (std::size_t v = 0; v < in.vertices; ++v) {
    const std::int64_t begin = in.first[v], end = in.first[v + 1];
    Pair d[8] = {}, s[6] = {};
    for (std::int64_t k = begin; k < end; ++k) {
      const double* a = palette + 16 * in.joints[k];
      Pair w = in.weights[k];
      if constexpr (Stretched) {
        const double* stretch = stretches + 18 * in.joints[k];
        for (int i = 0, from[6] = {0, 1, 2, 4, 5, 8}; i < 6; ++i)
          s[i] += w * Pair::of(stretch + 2 * from[i]);
      }
      if (k > begin) {
        const double* pivot = palette + 16 * in.joints[begin];
        Pair sum = Pair::of(a) * Pair::of(pivot);
        for (int i = 2; i < 8; i += 2) sum += Pair::of(a + i) * Pair::of(pivot + i);
        w = select(less(sum, 0.0), -w, w);
      }
      for (int i = 0; i < 8; ++i) d[i] += w * Pair::of(a + 2 * i);
    }
    Vector3<Pair> p = gather<Pair>(points, 3 * v);
    if constexpr (Stretched)
      p = {s[0] * p.x + s[1] * p.y + s[2] * p.z, s[1] * p.x + s[3] * p.y + s[4] * p.z,
           s[2] * p.x + s[4] * p.y + s[5] * p.z};
    const Pair squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + d[3] * d[3];
    const Pair f = select(less(squared, SHORTEST * SHORTEST), 0.0, 2.0 / squared);
    const Vector3<Pair> axis = {d[0], d[1], d[2]}, across = cross(axis, p);
    const Vector3<Pair> turned = cross(
        axis,
        {across.x + d[3] * p.x + d[4], across.y + d[3] * p.y + d[5], across.z + d[3] * p.z + d[6]});
    scatter(Vector3<Pair>{p.x + f * (turned.x + d[3] * d[4] - d[7] * d[0]),
                          p.y + f * (turned.y + d[3] * d[5] - d[7] * d[1]),
                          p.z + f * (turned.z + d[3] * d[6] - d[7] * d[2])},
            out, 3 * v);
    if (!normalize) continue;
    unit(out[0] + 3 * v);
    if (out[1] != out[0]) unit(out[1] + 3 * v);
  }
}

// The columns of transforms (U, 3, 4), each with a zero below.
void columns_of(const double* transforms, std::size_t joints, double* out) {
  for (std::size_t j = 0; j < joints; ++j, transforms += 12, out += 16)
    for (int c = 0; c < 4; ++c)
      for (int r = 0; r < 4; ++r) out[4 * c + r] = r < 3 ? transforms[4 * r + c] : 0;
}

}  // namespace

void skin_linear(In<double, 3> points, In<std::int64_t, 1> first, In<std::int32_t, 1> joints,
                 In<double, 1> weights, In<double, 4> transforms, bool normalize,
                 Filled<double, 3> out) {
  const std::size_t frames = transforms.shape(0), count = transforms.shape(1);
  check::shape("transforms", transforms, {check::ANY, check::ANY, 3, 4});
  check::at_most("transforms", count, check::MAX_ROWS);
  const Influences in = influences_of(first, joints, weights, count);
  const Points source(points, frames, in.vertices);
  const std::size_t row = in.vertices * 3, width = count * 12;
  check::shape("out", out, {frames, in.vertices, 3});
  double* const result = out.data();
  std::vector<double> palette(FRAMES * width);
  const Blend blend = blend_in_quads().value_or(make_blend<Pair, Plain>());
  for (std::size_t f = 0; f < frames; f += FRAMES) {
    if (f + 1 == frames) {
      columns_of(transforms.data() + f * width, count, palette.data());
      blend.frame(in, palette.data(), source.frame(f), result + f * row);
      for (std::size_t v = 0; normalize && v < in.vertices; ++v) unit(result + f * row + 3 * v);
      break;
    }
    const double *tables[FRAMES], *sources[FRAMES];
    double* targets[FRAMES];
    for (std::size_t l = 0; l < FRAMES; ++l) {
      const std::size_t g = std::min(f + l, frames - 1);
      tables[l] = transforms.data() + g * width;
      sources[l] = source.frame(g);
      targets[l] = result + g * row;
    }
    interleave(tables, width, palette.data());
    blend.frames(in, palette.data(), sources, targets);
    for (std::size_t g = f; normalize && g < std::min(f + FRAMES, frames); ++g)
      for (std::size_t v = 0; v < in.vertices; ++v) unit(result + g * row + 3 * v);
  }
}

void skin_dual_quaternion(In<double, 3> points, In<std::int64_t, 1> first,
                          In<std::int32_t, 1> joints, In<double, 1> weights,
                          In<double, 3> rotations, In<double, 3> translations,
                          std::optional<In<double, 4>> stretches, bool normalize,
                          Filled<double, 3> out) {
  const std::size_t frames = rotations.shape(0), count = rotations.shape(1);
  check::shape("rotations", rotations, {check::ANY, check::ANY, 4});
  check::at_most("rotations", count, check::MAX_ROWS);
  check::shape("translations", translations, {frames, count, 3});
  if (stretches) check::shape("stretches", *stretches, {frames, count, 3, 3});
  const Influences in = influences_of(first, joints, weights, count);
  const Points source(points, frames, in.vertices);
  const std::size_t row = in.vertices * 3, width = count * 8;
  check::shape("out", out, {frames, in.vertices, 3});
  double* const result = out.data();
  std::vector<double> duals(2 * width), palette(2 * width);
  std::vector<double> scaling(stretches ? 2 * count * 9 : 0);
  for (std::size_t f = 0; f < frames; f += 2) {
    const std::size_t both[2] = {f, std::min(f + 1, frames - 1)};
    for (int i = 0; i < 2; ++i)
      dual_quaternions(rotations.data() + both[i] * count * 4,
                       translations.data() + both[i] * count * 3, count, duals.data() + i * width);
    interleave({duals.data(), duals.data() + width}, width, palette.data());
    const double* const from[2] = {source.frame(both[0]), source.frame(both[1])};
    double* const to[2] = {result + both[0] * row, result + both[1] * row};
    if (stretches) {
      const double* of = stretches->data();
      interleave({of + both[0] * count * 9, of + both[1] * count * 9}, count * 9, scaling.data());
    }
    (stretches ? dual_frames<true> : dual_frames<false>)(in, palette.data(), scaling.data(), from,
                                                         to, normalize);
  }
}

}  // namespace animtool
