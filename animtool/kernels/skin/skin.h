// Skinning and blend shapes of points.
#pragma once

#include <cstdint>
#include <optional>

#include "base/arrays.h"

namespace animtool {

void skin_linear(In<double, 3> points, In<std::int64_t, 1> first, In<std::int32_t, 1> joints,
                 In<double, 1> weights, In<double, 4> transforms, bool normalizes,
                 Filled<double, 3> out);

void skin_dual_quaternion(In<double, 3> points, In<std::int64_t, 1> first,
                          In<std::int32_t, 1> joints, In<double, 1> weights,
                          In<double, 3> rotations, In<double, 3> translations,
                          std::optional<In<double, 4>> stretches, bool normalizes,
                          Filled<double, 3> out);

void add_sparse(In<double, 3> points, In<double, 2> weights, In<std::int64_t, 1> first,
                In<std::int32_t, 1> columns, In<double, 2> offsets, Filled<double, 3> out);

Out<double, 3> point_extents(In<double, 3> points);

}  // namespace animtool
