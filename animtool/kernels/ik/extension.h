// How far limbs extend towards what is too far: softly, and by stretching their bones.
#pragma once

#include <vector>

#include "base/arrays.h"
#include "ik/goals.h"

namespace animtool::ik {

// The way from a joint that stays in its place to a goal's point, lengths in shares of the
// chain's.
struct Limb {
  std::size_t goal;
  double origin[3];  // of its root
  double reach;      // its length when as straight as it can be
  double bones;      // by how much that grows while the bones grow by 1 of their length
  double soft;       // share of the reach over which its extension eases out
  double stretch;    // most that its bones grow by
};

std::vector<Limb> read_limbs(const In<std::int64_t, 1>& goals, const In<double, 2>& numbers,
                             std::size_t count);

// Of one problem with `count` goals: targets that the limbs can seek, what their bones are
// multiplied by (E,), and where ease alone keeps one from its target (E,).
void extend(const std::vector<Limb>& limbs, std::size_t count, const double* targets,
            double* sought, double* scales, bool* eased);

}  // namespace animtool::ik
