// Joint coordinates and local transforms.
#pragma once

#include <cstdint>
#include <vector>

#include "base/arrays.h"

namespace animtool {

// Joint types: FREE has three translations and a quaternion, BALL only the quaternion.
enum class Freedom { FIXED = 0, PIN = 1, SLIDE = 2, BALL = 3, FREE = 4 };

// Joints as Python has them, of the caller's memory.
struct JointArrays {
  In<std::int64_t, 1> types, columns;
  In<double, 2> axes, rest_translations, rest_rotations;

  std::size_t size() const { return types.shape(0); }
  // Numbers of a row of coordinates; refuses types, columns and shapes that do not fit.
  std::size_t check() const;
};

// Fills in the local translations (J, 3) and rotations (J, 4) of a row of coordinates.
void local_frame(const JointArrays& joints, const double* q, double* translations,
                 double* rotations);

}  // namespace animtool
