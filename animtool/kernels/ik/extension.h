// Extension of limbs towards targets that are too far away: softly, and by stretching their bones.
#pragma once

#include <vector>

#include "base/arrays.h"
#include "ik/goals.h"

namespace animtool::ik {

// A limb from a joint with a fixed position to the point of a goal. Lengths are fractions of the
// chain's length.
struct Limb {
  std::size_t goal;
  double origin[3];    // position of its root
  double max_length;   // its length when fully extended
  double bone_length;  // growth of the length per relative stretch of the bones
  double softness;     // fraction of the length over which the extension eases out
  double max_stretch;  // largest relative stretch of its bones
};

std::vector<Limb> read_limbs(const In<std::int64_t, 1>& goals, const In<double, 2>& numbers,
                             std::size_t count);

// Extends the limbs of one problem with `count` goals. Computes targets that the limbs can reach,
// factors of their bone lengths (E,), and whether only the soft extension keeps a limb from its
// target (E,).
void extend_limbs(const std::vector<Limb>& limbs, std::size_t goal_count, const double* targets,
                  double* reachable, double* scales, bool* is_softened);

}  // namespace animtool::ik
