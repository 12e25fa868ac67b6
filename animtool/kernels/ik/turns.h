// The turn of one joint that serves its goals best by itself.
#pragma once

#include "ik/chain.h"

namespace animtool::ik {

// Sums over what a joint turns, for C cos(angle) + S sin(angle) about an axis, which is to
// be the largest: for a vector that is to turn onto another, their product; for a
// rotation that is left to make, its trace (C. Welman, Inverse kinematics and geometric
// constraints for articulated figure manipulation, 1993).
struct Pull {
  double moment[9] = {};  // sum of a b^T
  double torque[3] = {};  // sum of a x b: S = axis . torque
  double trace = 0;       // sum of a . b: C = trace - axis . moment axis

  void add(double weight, const double* from, const double* to) {
    double turn[3];
    cross(from, to, turn);
    trace += weight * dot(from, to);
    for (int i = 0; i < 3; ++i) {
      torque[i] += weight * turn[i];
      for (int j = 0; j < 3; ++j) moment[3 * i + j] += weight * from[i] * to[j];
    }
  }

  // A rotation that is left to make: half of it, for its trace counts an angle twice.
  void add(double weight, const double* left) {
    const double half = weight / 2;
    trace += half * (left[0] + left[4] + left[8]);
    torque[0] += half * (left[7] - left[5]);
    torque[1] += half * (left[2] - left[6]);
    torque[2] += half * (left[3] - left[1]);
    for (int i = 0; i < 9; ++i) moment[i] += half * left[i];
  }

  double angle(const double* axis) const {
    double turned[3];
    rotate(moment, axis, turned);
    return std::atan2(dot(axis, torque), trace - dot(axis, turned));
  }
};

// Fills in the step of a pin or ball that follows the pull: about its axis, or about that
// of the torque.
inline void follow(const Node& node, const double* axes, const Pull& pull, double* delta) {
  if (node.kind == Kind::PIN) {
    delta[node.dof] = pull.angle(axes) / node.gain;
    return;
  }
  const double size = length(pull.torque);
  if (!(size > 1e-300)) return;
  const double axis[3] = {pull.torque[0] / size, pull.torque[1] / size, pull.torque[2] / size};
  const double angle = pull.angle(axis);
  for (int k = 0; k < 3; ++k) delta[node.dof + k] = angle * dot(axis, axes + 3 * k);
}

}  // namespace animtool::ik
