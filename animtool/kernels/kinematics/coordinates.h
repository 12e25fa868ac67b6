// Joint coordinates and local transforms.
#pragma once

#include <cstdint>
#include <vector>

#include "base/arrays.h"

namespace animtool {

// Joint types. FREE has three translations and a quaternion, BALL only a quaternion.
enum class Freedom { FIXED = 0, PIN = 1, SLIDE = 2, BALL = 3, FREE = 4 };

// Joints in the arrays that Python passes. The caller owns the memory.
struct JointArrays {
  In<std::int64_t, 1> types, columns;
  In<double, 2> axes, rest_translations, rest_rotations;

  std::size_t size() const { return types.shape(0); }
  // Returns the number of coordinates in a row. Refuses types, columns and shapes that do not
  // match.
  std::size_t check() const;
};

// Computes the local translations (J, 3) and rotations (J, 4) from a row of coordinates.
void local_frame(const JointArrays& joints, const double* coordinates, double* translations,
                 double* rotations);

}  // namespace animtool
