// Forward kinematics of a chain, and differences of its poses.
#include "ik/chain.h"

namespace animtool::ik {

void forward(const Chain& chain, const double* q, std::size_t first, std::size_t end,
             Frames& frames) {
  if (!chain.programs.empty()) Evaluation(chain.programs, q, frames.results).run();
  for (std::size_t n = first; n < end; ++n) {
    const Node& node = chain.nodes[n];
    double unrotated[9];
    double* origin = &frames.origins[3 * n];
    double* rotation = &frames.rotations[9 * n];
    double* axes = &frames.axes[9 * n];
    if (node.parent < 0) {
      std::copy(node.rest, node.rest + 9, unrotated);
      std::copy(node.offset, node.offset + 3, origin);
    } else {
      const double* parent = &frames.rotations[9 * node.parent];
      const double* base = &frames.origins[3 * node.parent];
      multiply(parent, node.rest, unrotated);
      rotate(parent, node.offset, origin);
      for (int i = 0; i < 3; ++i) origin[i] += base[i];
    }
    const double* numbers = q + node.coordinate;
    if (node.kind == Kind::BALL) {
      double motion[9];
      to_matrix(numbers, motion);
      multiply(unrotated, motion, rotation);
      for (int i = 0; i < 9; ++i) axes[3 * (i % 3) + i / 3] = unrotated[i];
      continue;
    }
    const double by = node.program < 0 ? numbers[0] : frames.results.values[node.program];
    const double value = node.gain * by + node.shift;
    for (int i = 0; i < 3; ++i) axes[i] = unrotated[3 * i + 2];
    if (node.kind == Kind::PIN) {
      rotate_about_z(unrotated, value, rotation);
    } else {
      std::copy(unrotated, unrotated + 9, rotation);
      for (int i = 0; i < 3; ++i) origin[i] += axes[i] * value;
    }
  }
}

void difference(const Chain& chain, const double* from, const double* to, double* out) {
  for (const Node& node : chain.nodes) {
    if (node.follows) continue;
    const double *a = from + node.coordinate, *b = to + node.coordinate;
    if (node.kind == Kind::BALL) {
      const double back[4] = {-a[0], -a[1], -a[2], a[3]};
      double between[4];
      product(b, back, between);
      logarithm(between, out + node.dof);
    } else {
      out[node.dof] = b[0] - a[0];
    }
  }
}

void follow(const Node& node, const double* axes, const Pull& pull, double* delta) {
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
