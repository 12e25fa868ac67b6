// Extension of limbs towards targets out of reach: softly, and by stretching their bones.
#pragma once

#include <vector>

#include "base/arrays.h"
#include "ik/goals.h"

namespace animtool::ik {

// A limb from a joint with a fixed position to the point of a goal. Lengths are fractions of the
// chain's length.
struct Limb {
  std::size_t goal;
  double origin[3];  // of its root
  double reach;      // its length when fully extended
  double bones;      // growth of the reach per relative stretch of the bones
  double soft;       // fraction of the reach over which the extension eases out
  double stretch;    // largest relative stretch of its bones
};

std::vector<Limb> read_limbs(const In<std::int64_t, 1>& goals, const In<double, 2>& numbers,
                             std::size_t count);

// For one problem with `count` goals: targets within reach of the limbs, factors of their bone
// lengths (E,), and whether only the soft extension keeps a limb from its target (E,).
void extend(const std::vector<Limb>& limbs, std::size_t count, const double* targets,
            double* reachable, double* scales, bool* softened);

}  // namespace animtool::ik
