// Skinning with linear blending and with dual quaternions, several frames at once.
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/checks.h"
#include "skin/blend.h"
#include "skin/skin.h"

namespace animtool {

namespace {

Influences read_influences(const In<std::int64_t, 1>& first, const In<std::int32_t, 1>& joints,
                           const In<double, 1>& weights, std::size_t joint_count) {
  const std::size_t influence_count = joints.shape(0);
  check::shape("first", first, {check::ANY});
  check::shape("joints", joints, {check::ANY});
  check::shape("weights", weights, {influence_count});
  check::starts("first", first, influence_count);
  check::indices("joints", joints, 0, static_cast<std::int64_t>(joint_count));
  return {first.shape(0) - 1, first.data(), joints.data(), weights.data()};
}

// Points that are either the same in all frames or different in each frame.
class FramePoints {
 public:
  FramePoints(const In<double, 3>& points, std::size_t frames, std::size_t vertices)
      : data_(points.data()), stride_(points.shape(0) == 1 ? 0 : vertices * 3) {
    check::shape("points", points, {points.shape(0) == 1 ? 1 : frames, vertices, 3});
  }
  const double* frame(std::size_t f) const { return data_ + f * stride_; }

 private:
  const double* data_;
  std::size_t stride_;
};

inline void make_unit(double* v) {
  const double squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
  if (!(squared > 0)) return;
  const double length = std::sqrt(squared);
  for (int i = 0; i < 3; ++i) v[i] /= length;
}

// Computes the dual quaternion of each joint: the rotation x y z w, then the dual part x y z w.
void dual_quaternions(const double* rotation, const double* translation, std::size_t joints,
                      double* out) {
  for (std::size_t j = 0; j < joints; ++j, rotation += 4, translation += 3, out += 8) {
    std::copy_n(rotation, 4, out);
    out[4] = 0.5 * (rotation[3] * translation[0] + translation[1] * rotation[2] -
                    translation[2] * rotation[1]);
    out[5] = 0.5 * (rotation[3] * translation[1] + translation[2] * rotation[0] -
                    translation[0] * rotation[2]);
    out[6] = 0.5 * (rotation[3] * translation[2] + translation[0] * rotation[1] -
                    translation[1] * rotation[0]);
    out[7] = -0.5 * (translation[0] * rotation[0] + translation[1] * rotation[1] +
                     translation[2] * rotation[2]);
  }
}

// A blended quaternion that is shorter than this rotates nothing, as in UsdSkel.
constexpr double MIN_QUATERNION_LENGTH = 1e-10;

// Blends the dual quaternions of two frames at once. More frames would not fit into the registers.
template <bool has_stretches>
void blend_dual_frames(const Influences& influences, const double* palette, const double* stretches,
                       const double* const (&points)[2], double* const (&out)[2], bool normalizes) {
  for (std::size_t vertex = 0; vertex < influences.vertices; ++vertex) {
    const std::int64_t begin = influences.first[vertex], end = influences.first[vertex + 1];
    FramePair blended_dual[8] = {}, stretch_sums[6] = {};
    for (std::int64_t influence = begin; influence < end; ++influence) {
      const double* dual = palette + 16 * influences.joints[influence];
      FramePair weight = influences.weights[influence];
      if constexpr (has_stretches) {
        const double* stretch = stretches + 18 * influences.joints[influence];
        for (int i = 0, matrix_indices[6] = {0, 1, 2, 4, 5, 8}; i < 6; ++i)
          stretch_sums[i] += weight * FramePair::load(stretch + 2 * matrix_indices[i]);
      }
      if (influence > begin) {
        const double* first_dual = palette + 16 * influences.joints[begin];
        FramePair dot_product = FramePair::load(dual) * FramePair::load(first_dual);
        for (int i = 2; i < 8; i += 2)
          dot_product += FramePair::load(dual + i) * FramePair::load(first_dual + i);
        weight = select(less(dot_product, 0.0), -weight, weight);
      }
      for (int i = 0; i < 8; ++i) blended_dual[i] += weight * FramePair::load(dual + 2 * i);
    }
    Vector3<FramePair> point = gather<FramePair>(points, 3 * vertex);
    if constexpr (has_stretches)
      point = {stretch_sums[0] * point.x + stretch_sums[1] * point.y + stretch_sums[2] * point.z,
               stretch_sums[1] * point.x + stretch_sums[3] * point.y + stretch_sums[4] * point.z,
               stretch_sums[2] * point.x + stretch_sums[4] * point.y + stretch_sums[5] * point.z};
    const FramePair squared_length =
        blended_dual[0] * blended_dual[0] + blended_dual[1] * blended_dual[1] +
        blended_dual[2] * blended_dual[2] + blended_dual[3] * blended_dual[3];
    const FramePair scale =
        select(less(squared_length, MIN_QUATERNION_LENGTH * MIN_QUATERNION_LENGTH), 0.0,
               2.0 / squared_length);
    const Vector3<FramePair> axis = {blended_dual[0], blended_dual[1], blended_dual[2]},
                             axis_cross = cross(axis, point);
    const Vector3<FramePair> rotated_offset =
        cross(axis, {axis_cross.x + blended_dual[3] * point.x + blended_dual[4],
                     axis_cross.y + blended_dual[3] * point.y + blended_dual[5],
                     axis_cross.z + blended_dual[3] * point.z + blended_dual[6]});
    scatter(
        Vector3<FramePair>{point.x + scale * (rotated_offset.x + blended_dual[3] * blended_dual[4] -
                                              blended_dual[7] * blended_dual[0]),
                           point.y + scale * (rotated_offset.y + blended_dual[3] * blended_dual[5] -
                                              blended_dual[7] * blended_dual[1]),
                           point.z + scale * (rotated_offset.z + blended_dual[3] * blended_dual[6] -
                                              blended_dual[7] * blended_dual[2])},
        out, 3 * vertex);
    if (!normalizes) continue;
    make_unit(out[0] + 3 * vertex);
    if (out[1] != out[0]) make_unit(out[1] + 3 * vertex);
  }
}

// Stores the columns of transforms (U, 3, 4), each followed by a zero.
void transpose_transforms(const double* transforms, std::size_t joints, double* out) {
  for (std::size_t j = 0; j < joints; ++j, transforms += 12, out += 16)
    for (int column = 0; column < 4; ++column)
      for (int row = 0; row < 4; ++row)
        out[4 * column + row] = row < 3 ? transforms[4 * row + column] : 0;
}

}  // namespace

void skin_linear(In<double, 3> points, In<std::int64_t, 1> first, In<std::int32_t, 1> joints,
                 In<double, 1> weights, In<double, 4> transforms, bool normalizes,
                 Filled<double, 3> out) {
  const std::size_t frames = transforms.shape(0), joint_count = transforms.shape(1);
  check::shape("transforms", transforms, {check::ANY, check::ANY, 3, 4});
  check::at_most("transforms", joint_count, check::MAX_ROWS);
  const Influences influences = read_influences(first, joints, weights, joint_count);
  const FramePoints source(points, frames, influences.vertices);
  const std::size_t row_size = influences.vertices * 3, width = joint_count * 12;
  check::shape("out", out, {frames, influences.vertices, 3});
  double* const result = out.data();
  std::vector<double> palette(FRAMES_AT_ONCE * width);
  const BlendFunctions blend =
      blend_in_quads().value_or(make_blend_functions<FramePair, Portable>());
  for (std::size_t first_frame = 0; first_frame < frames; first_frame += FRAMES_AT_ONCE) {
    if (first_frame + 1 == frames) {
      transpose_transforms(transforms.data() + first_frame * width, joint_count, palette.data());
      blend.blend_frame(influences, palette.data(), source.frame(first_frame),
                        result + first_frame * row_size);
      for (std::size_t vertex = 0; normalizes && vertex < influences.vertices; ++vertex)
        make_unit(result + first_frame * row_size + 3 * vertex);
      break;
    }
    const double *tables[FRAMES_AT_ONCE], *sources[FRAMES_AT_ONCE];
    double* targets[FRAMES_AT_ONCE];
    for (std::size_t i = 0; i < FRAMES_AT_ONCE; ++i) {
      const std::size_t frame = std::min(first_frame + i, frames - 1);
      tables[i] = transforms.data() + frame * width;
      sources[i] = source.frame(frame);
      targets[i] = result + frame * row_size;
    }
    interleave(tables, width, palette.data());
    blend.blend_frames(influences, palette.data(), sources, targets);
    for (std::size_t frame = first_frame;
         normalizes && frame < std::min(first_frame + FRAMES_AT_ONCE, frames); ++frame)
      for (std::size_t vertex = 0; vertex < influences.vertices; ++vertex)
        make_unit(result + frame * row_size + 3 * vertex);
  }
}

void skin_dual_quaternion(In<double, 3> points, In<std::int64_t, 1> first,
                          In<std::int32_t, 1> joints, In<double, 1> weights,
                          In<double, 3> rotations, In<double, 3> translations,
                          std::optional<In<double, 4>> stretches, bool normalizes,
                          Filled<double, 3> out) {
  const std::size_t frames = rotations.shape(0), joint_count = rotations.shape(1);
  check::shape("rotations", rotations, {check::ANY, check::ANY, 4});
  check::at_most("rotations", joint_count, check::MAX_ROWS);
  check::shape("translations", translations, {frames, joint_count, 3});
  if (stretches) check::shape("stretches", *stretches, {frames, joint_count, 3, 3});
  const Influences influences = read_influences(first, joints, weights, joint_count);
  const FramePoints source(points, frames, influences.vertices);
  const std::size_t row_size = influences.vertices * 3, width = joint_count * 8;
  check::shape("out", out, {frames, influences.vertices, 3});
  double* const result = out.data();
  std::vector<double> dual_table(2 * width), palette(2 * width);
  std::vector<double> stretch_palette(stretches ? 2 * joint_count * 9 : 0);
  for (std::size_t first_frame = 0; first_frame < frames; first_frame += 2) {
    const std::size_t frame_pair[2] = {first_frame, std::min(first_frame + 1, frames - 1)};
    for (int i = 0; i < 2; ++i)
      dual_quaternions(rotations.data() + frame_pair[i] * joint_count * 4,
                       translations.data() + frame_pair[i] * joint_count * 3, joint_count,
                       dual_table.data() + i * width);
    interleave({dual_table.data(), dual_table.data() + width}, width, palette.data());
    const double* const sources[2] = {source.frame(frame_pair[0]), source.frame(frame_pair[1])};
    double* const targets[2] = {result + frame_pair[0] * row_size,
                                result + frame_pair[1] * row_size};
    if (stretches) {
      const double* stretch_values = stretches->data();
      interleave({stretch_values + frame_pair[0] * joint_count * 9,
                  stretch_values + frame_pair[1] * joint_count * 9},
                 joint_count * 9, stretch_palette.data());
    }
    (stretches ? blend_dual_frames<true> : blend_dual_frames<false>)(influences, palette.data(),
                                                                     stretch_palette.data(),
                                                                     sources, targets, normalizes);
  }
}

}  // namespace animtool
