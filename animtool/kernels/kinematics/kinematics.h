// Kinematics of joints and points.
#pragma once

#include <cstdint>
#include <optional>
#include <tuple>
#include <vector>

#include "base/arrays.h"

namespace animtool {

Out<double, 3> euler_to_quaternion(In<double, 2> values, In<std::int32_t, 2> columns,
                                   In<std::int32_t, 2> axes, In<double, 2> previous);

Out<double, 3> quaternion_to_euler(In<double, 3> quaternions, In<std::int32_t, 2> axes);

// Translations and rotations.
using LocalTransforms = std::tuple<Out<double, 3>, Out<double, 3>>;
LocalTransforms coordinates_to_local(In<std::int64_t, 1> types, In<std::int64_t, 1> columns,
                                     In<double, 2> axes, In<double, 2> rest_translations,
                                     In<double, 2> rest_rotations, In<double, 2> coordinates);

void forward_kinematics(In<std::int64_t, 1> parents, In<double, 3> translations,
                        In<double, 3> rotations, std::optional<In<double, 3>> scales,
                        Filled<double, 3> positions, Filled<double, 4> linear);

// Values of joints at rest (J, K), the indices of animated joints (A,), and their values (F, A, K).
struct MotionChannel {
  In<double, 2> rest;
  In<std::int64_t, 1> animated;
  In<double, 3> values;
};

struct MotionArrays {
  In<std::int64_t, 1> parents;
  MotionChannel translations, rotations;
  std::optional<MotionChannel> scales;
  Filled<double, 3> positions;
  Filled<double, 4> linear;
};
void forward_motion(const MotionArrays& arrays);

// Extents, error, frame and joint.
using RoundingReport = std::tuple<Out<double, 3>, double, std::size_t, std::size_t>;
RoundingReport measure_rounding(In<std::int64_t, 1> parents, In<double, 3> translations,
                                In<double, 3> rotations, std::optional<In<double, 3>> scales,
                                In<float, 3> written_translations, In<float, 3> written_rotations,
                                std::optional<In<float, 3>> written_scales);

// Rounded points, error, frame and vertex.
using RoundedPoints = std::tuple<Out<float, 3>, double, std::size_t, std::size_t>;
RoundedPoints round_points(In<double, 3> points, double unit);

// Returns nothing if every sign already continues the previous one.
std::optional<Out<float, 3>> continue_signs(In<float, 3> rotations, In<float, 2> previous);

Out<double, 2> point_errors(In<double, 3> points, In<double, 3> true_positions,
                            In<double, 4> true_linear, In<double, 3> positions,
                            In<double, 4> linear);

// The smallest and the largest squared length.
std::tuple<double, double> squared_lengths(In<float, 2> quaternions);

Out<double, 3> unpack_rotations(const std::vector<In<float, 2>>& tracks,
                                std::optional<In<double, 2>> previous);

// Rotations and stretches.
using StretchSplit = std::tuple<Out<double, 3>, Out<double, 4>>;
StretchSplit split_stretch(In<double, 4> linear);

}  // namespace animtool
