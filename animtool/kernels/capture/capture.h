// Kernels for motion capture: cameras, faces and rows of BVH files.
#pragma once

#include <cstdint>
#include <optional>
#include <tuple>

#include "base/arrays.h"

namespace animtool {

// values, row_lines, consumed, lines, fault, count, token
using BvhRows = std::tuple<Out<double, 2>, Out<std::int64_t, 1>, std::size_t, std::size_t, int,
                           std::size_t, Bytes>;
BvhRows parse_bvh_rows(Text text, std::size_t columns, std::size_t limit, bool is_final);

Bytes format_bvh_rows(In<double, 2> values, In<std::int64_t, 1> decimals);

// weights, poses, residuals, robust weights, iterations, change
using FaceFit =
    std::tuple<Out<double, 2>, Out<double, 2>, Out<double, 2>, Out<double, 2>, int, double>;
FaceFit fit_face(In<double, 3> neutral, In<double, 3> deltas, In<double, 3> observed,
                 std::optional<In<double, 1>> camera, In<double, 2> poses, In<double, 2> weights,
                 double threshold, double smooth, double rest, double tolerance, int max_iterations,
                 bool is_warm_start);

// points, numbers, tallies, residuals, states
using Triangulation =
    std::tuple<Out<double, 3>, Out<double, 3>, Out<double, 3>, Out<float, 4>, Out<std::uint8_t, 3>>;
Triangulation triangulate_points(In<double, 4> pixels, std::optional<In<double, 3>> confidences,
                                 In<double, 2> cameras, In<bool, 2> is_active, In<double, 1> noise,
                                 double outlier_gate, double max_condition, bool has_details);

Out<double, 2> least_median_residuals(In<double, 4> pixels, In<double, 2> cameras);

}  // namespace animtool
