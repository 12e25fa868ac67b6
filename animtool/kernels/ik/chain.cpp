// Forward kinematics of a chain, and differences of its poses.
#include "ik/chain.h"

namespace animtool::ik {

void compute_frames(const Chain& chain, const double* q, std::size_t first, std::size_t end,
                    Frames& frames) {
  if (!chain.programs.empty()) Evaluation(chain.programs, q, frames.results).run();
  for (std::size_t n = first; n < end; ++n) {
    const Node& node = chain.nodes[n];
    double zero_rotation[9];
    double* origin = &frames.origins[3 * n];
    double* rotation = &frames.rotations[9 * n];
    double* axes = &frames.axes[9 * n];
    if (node.parent < 0) {
      std::copy(node.rest, node.rest + 9, zero_rotation);
      std::copy(node.offset, node.offset + 3, origin);
    } else {
      const double* parent = &frames.rotations[9 * node.parent];
      const double* parent_origin = &frames.origins[3 * node.parent];
      multiply(parent, node.rest, zero_rotation);
      rotate(parent, node.offset, origin);
      for (int i = 0; i < 3; ++i) origin[i] += parent_origin[i];
    }
    const double* coordinates = q + node.coordinate;
    if (node.kind == Kind::BALL) {
      double motion[9];
      to_matrix(coordinates, motion);
      multiply(zero_rotation, motion, rotation);
      for (int i = 0; i < 9; ++i) axes[3 * (i % 3) + i / 3] = zero_rotation[i];
      continue;
    }
    const double coordinate =
        node.program < 0 ? coordinates[0] : frames.results.values[node.program];
    const double value = node.gain * coordinate + node.shift;
    for (int i = 0; i < 3; ++i) axes[i] = zero_rotation[3 * i + 2];
    if (node.kind == Kind::PIN) {
      rotate_about_z(zero_rotation, value, rotation);
    } else {
      std::copy(zero_rotation, zero_rotation + 9, rotation);
      for (int i = 0; i < 3; ++i) origin[i] += axes[i] * value;
    }
  }
}

void difference(const Chain& chain, const double* from, const double* to, double* out) {
  for (const Node& node : chain.nodes) {
    if (node.is_driven) continue;
    const double *a = from + node.coordinate, *b = to + node.coordinate;
    if (node.kind == Kind::BALL) {
      const double inverse[4] = {-a[0], -a[1], -a[2], a[3]};
      double relative_rotation[4];
      product(b, inverse, relative_rotation);
      logarithm(relative_rotation, out + node.dof);
    } else {
      out[node.dof] = b[0] - a[0];
    }
  }
}

void apply_alignment(const Node& node, const double* axes, const AlignmentSums& sums,
                     double* delta) {
  if (node.kind == Kind::PIN) {
    delta[node.dof] = sums.angle(axes) / node.gain;
    return;
  }
  const double torque_length = length(sums.torque);
  if (!(torque_length > 1e-300)) return;
  const double axis[3] = {sums.torque[0] / torque_length, sums.torque[1] / torque_length,
                          sums.torque[2] / torque_length};
  const double angle = sums.angle(axis);
  for (int k = 0; k < 3; ++k) delta[node.dof + k] = angle * dot(axis, axes + 3 * k);
}

}  // namespace animtool::ik
