// How far poses are apart.
#pragma once

#include "ik/chain.h"

namespace animtool::ik {

// Tangent vector (D,) that takes one pose to another, balls about their own rest frame.
inline void difference(const Chain& chain, const double* from, const double* to, double* out) {
  for (const Node& node : chain.nodes) {
    if (node.follows) continue;
    const double *a = from + node.coordinate, *b = to + node.coordinate;
    if (node.kind == Kind::BALL) {
      const double back[4] = {-a[0], -a[1], -a[2], a[3]};
      double turn[4];
      product(b, back, turn);
      logarithm(turn, out + node.dof);
    } else {
      out[node.dof] = b[0] - a[0];
    }
  }
}

// How a rotation vector v = log(b a^-1) changes with b, transposed, on y: the inverse
// left Jacobian of SO(3) for side 1; with a, negated, for side -1.
inline void pull_back(const double* v, const double* y, double side, double* out) {
  double first[3], second[3];
  cross(v, y, first);
  cross(v, first, second);
  const double square = dot(v, v), angle = std::sqrt(square);
  const double factor =
      angle < 1e-3 ? 1.0 / 12 : (1 - angle / 2 / std::tan(angle / 2)) / square;
  for (int i = 0; i < 3; ++i) out[i] = y[i] + side * first[i] / 2 + factor * second[i];
}

}  // namespace animtool::ik
