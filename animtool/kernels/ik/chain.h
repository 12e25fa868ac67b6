// Kinematic chain: its nodes and their world frames.
#pragma once

#include <vector>

#include "ik/driver.h"

namespace animtool::ik {

enum class Kind { PIN = 0, SLIDE = 1, BALL = 2 };

// A moving joint. The z axis of its frame is the axis of a pin, the direction of a slide, or the
// twist axis of a ball; the frames of a chain are built that way. Several nodes may depend on one
// coordinate: value = gain * coordinate + shift.
struct Node {
  Kind kind;
  int parent;               // -1 for the world
  double rest[9];           // parent_from_node
  double offset[3];         // its origin in the parent's frame
  double gain, shift;       // of pins and slides
  bool is_driven;           // an earlier node has the coordinate, or a program gives the value
  double limit[4];          // low, high; of a ball swing about x, swing about y, twist low, high
  double inside_bounds[5];  // precomputed from the limits of a ball, see `set_inside_bounds`
  int coordinate;           // index of its first coordinate, of 1 or 4
  int dof;                  // index of its first degree of freedom, of 1 or 3
  int program;              // program that gives the value instead of a coordinate, or -1

  // Number of degrees of freedom.
  int dof_count() const { return kind == Kind::BALL ? 3 : 1; }
};

struct Chain {
  std::vector<Node> nodes;
  std::vector<Program> programs;  // each after the programs whose results it reads
  int coordinate_count = 0;
  int dof_count = 0;
};

// World frames of the nodes after their motion, and their axes.
struct Frames {
  std::vector<double> rotations;  // (N, 3, 3)
  std::vector<double> origins;    // (N, 3)
  std::vector<double> axes;       // (N, 3, 3), one per row; pins and slides have only the first
  Results results;                // of the chain's programs

  explicit Frames(const Chain& chain)
      : rotations(9 * chain.nodes.size()),
        origins(3 * chain.nodes.size()),
        axes(9 * chain.nodes.size()) {
    std::size_t stack_size = 0, slope_count = 0;
    for (const Program& program : chain.programs) {
      stack_size = std::max(stack_size, program.depth * (1 + program.dofs.size()));
      slope_count += program.dofs.size();
    }
    results.values.resize(chain.programs.size());
    results.slopes.resize(slope_count);
    results.stack.resize(stack_size);
  }
};

// Calls `use(k, dof, gain)` for each axis k of a node and each degree of freedom that moves the
// node: its motion is `gain` times the change of `dof`, to first order.
template <class Use>
void for_each_slope(const Chain& chain, const Node& node, const Frames& frames, Use&& use) {
  if (node.program < 0) {
    for (int k = 0; k < node.dof_count(); ++k) use(k, node.dof + k, node.gain);
    return;
  }
  const Program& program = chain.programs[node.program];
  for (std::size_t s = 0; s < program.dofs.size(); ++s)
    use(0, program.dofs[s], node.gain * frames.results.slopes[program.first_slope + s]);
}

// Calls `use(dof)` for each degree of freedom that moves a node.
template <class Use>
void for_each_dof(const Chain& chain, const Node& node, Use&& use) {
  if (node.program < 0)
    for (int d = node.dof; d < node.dof + node.dof_count(); ++d) use(d);
  else
    for (const int d : chain.programs[node.program].dofs) use(d);
}

// Multiplies a rotation r by a rotation about z.
inline void rotate_about_z(const double* r, double angle, double* out) {
  const double cosine = std::cos(angle), sine = std::sin(angle);
  for (int i = 0; i < 9; i += 3) {
    out[i] = cosine * r[i] + sine * r[i + 1];
    out[i + 1] = cosine * r[i + 1] - sine * r[i];
    out[i + 2] = r[i + 2];
  }
}

// Computes the frames of the nodes in [first, end); those of earlier nodes must be up to date.
void compute_frames(const Chain& chain, const double* q, std::size_t first, std::size_t end,
                    Frames& frames);

inline void compute_frames(const Chain& chain, const double* q, Frames& frames) {
  compute_frames(chain, q, 0, chain.nodes.size(), frames);
}

// Velocity of a point and of the frame of a node, per unit motion about or along one of its axes.
inline void velocity(const Node& node, const double* axis, const double* origin,
                     const double* point, double* linear, double* angular) {
  if (node.kind == Kind::SLIDE) {
    for (int i = 0; i < 3; ++i) linear[i] = axis[i], angular[i] = 0;
    return;
  }
  const double arm[3] = {point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]};
  cross(axis, arm, linear);
  for (int i = 0; i < 3; ++i) angular[i] = axis[i];
}

// Computes the tangent vector (D,) from one pose to another; rotations of balls are in their rest
// frame.
void difference(const Chain& chain, const double* from, const double* to, double* out);

// Multiplies y by the transposed derivative of a rotation vector v = log(b a^-1): by b, the inverse
// left Jacobian of SO(3), for side 1; by a, negated, for side -1.
inline void pull_back(const double* v, const double* y, double side, double* out) {
  double v_cross_y[3], v_cross_v_cross_y[3];
  cross(v, y, v_cross_y);
  cross(v, v_cross_y, v_cross_v_cross_y);
  const double squared_angle = dot(v, v), angle = std::sqrt(squared_angle);
  const double factor =
      angle < 1e-3 ? 1.0 / 12 : (1 - angle / 2 / std::tan(angle / 2)) / squared_angle;
  for (int i = 0; i < 3; ++i)
    out[i] = y[i] + side * v_cross_y[i] / 2 + factor * v_cross_v_cross_y[i];
}

// Sums over everything that a joint rotates, to find the rotation that serves its goals best. For a
// rotation about an axis they give C cos(angle) + S sin(angle), which is maximised: the dot product
// of a vector with its target, or the trace of a remaining rotation (C. Welman, Inverse kinematics
// and geometric constraints for articulated figure manipulation, 1993).
struct AlignmentSums {
  double moment[9] = {};  // sum of a b^T
  double torque[3] = {};  // sum of a x b: S = axis . torque
  double trace = 0;       // sum of a . b: C = trace - axis . moment axis

  // Adds a vector and its target.
  void add(double weight, const double* from, const double* to) {
    double cross_product[3];
    cross(from, to, cross_product);
    trace += weight * dot(from, to);
    for (int i = 0; i < 3; ++i) {
      torque[i] += weight * cross_product[i];
      for (int j = 0; j < 3; ++j) moment[3 * i + j] += weight * from[i] * to[j];
    }
  }

  // Adds a remaining rotation: half of it, because its trace counts the angle twice.
  void add(double weight, const double* remaining_rotation) {
    const double half = weight / 2;
    trace += half * (remaining_rotation[0] + remaining_rotation[4] + remaining_rotation[8]);
    torque[0] += half * (remaining_rotation[7] - remaining_rotation[5]);
    torque[1] += half * (remaining_rotation[2] - remaining_rotation[6]);
    torque[2] += half * (remaining_rotation[3] - remaining_rotation[1]);
    for (int i = 0; i < 9; ++i) moment[i] += half * remaining_rotation[i];
  }

  // The best angle about an axis.
  double angle(const double* axis) const {
    double transformed[3];
    rotate(moment, axis, transformed);
    return std::atan2(dot(axis, torque), trace - dot(axis, transformed));
  }
};

// Computes the step of a pin about its axis, or of a ball about the axis of the torque.
void apply_alignment(const Node& node, const double* axes, const AlignmentSums& sums,
                     double* delta);

}  // namespace animtool::ik
