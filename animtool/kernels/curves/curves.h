// Key curves: evaluation and fitting.
#pragma once

#include <cstdint>
#include <optional>
#include <tuple>

#include "base/arrays.h"

namespace animtool {

// The values, unless there is an array to fill.
std::optional<Out<double, 2>> evaluate_curves(In<std::int64_t, 1> first, In<double, 1> times,
                                              In<double, 1> values, In<std::int64_t, 1> kinds,
                                              In<double, 2> ins, In<double, 2> outs,
                                              In<double, 2> at,
                                              std::optional<Filled<double, 2>> out);

Out<double, 3> evaluate_rotations(In<double, 1> times, In<double, 3> keys,
                                  In<std::int64_t, 1> kinds, In<double, 1> at,
                                  In<double, 1> times_beyond, In<double, 1> cycle_counts);

// The rotation vectors from each of F frames to the next (F - 1, C, 3).
Out<double, 3> rotation_steps(In<double, 3> rotations);

// Spherical interpolation of pairs of rotations.
Out<double, 2> slerp(In<double, 2> starts, In<double, 2> ends, In<double, 1> fractions);

// frames, ins, outs
using CubicFit = std::tuple<Out<std::int64_t, 1>, Out<double, 2>, Out<double, 2>>;
CubicFit fit_cubics(In<double, 2> values, In<double, 1> bounds, In<std::int64_t, 1> anchors,
                    In<double, 1> low, In<double, 1> high, In<std::int64_t, 1> straight_frames);

// Spans of frames whose poses interpolation reproduces, and corrections of their root.
std::tuple<Out<bool, 1>, Out<double, 3>> fitting_spans(
    In<double, 3> joint_rotations, In<std::int64_t, 1> parents, In<std::int64_t, 1> pose_indices,
    In<double, 2> positions, In<double, 2> pre_rotations, In<double, 2> rest_rotations,
    In<std::int64_t, 1> feet, In<bool, 2> foot_stands, In<std::int64_t, 1> span_starts,
    std::int64_t span_width, double max_joint_error, double max_foot_error, double max_root_shift);

}  // namespace animtool
