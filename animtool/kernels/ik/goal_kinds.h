// The kinds of goals: residuals, Jacobians, and alignment of single joints.
//
// A residual r is target minus value, so that r(q + d) = r(q) - J d to first order, and the
// gradient of the cost |r|^2 / 2 is exactly -J^T r: rotations are compared by their rotation vector
// in the world, separately from positions.
#pragma once

#include <array>
#include <tuple>
#include <utility>

#include "ik/chain.h"

namespace animtool::ik {

// The pose of the chain as seen by a goal kind.
struct GoalView {
  const double* rotation;                         // of the goal's node
  const double* point;                            // the goal's point
  const double* aim_axis;                         // in the node's frame
  int root, middle;                               // nodes of the limb, or -1
  const double *root_position, *middle_position;  // null without a limb
};

// Velocity of a goal's point and frame per unit motion about an axis of a node.
struct AxisMotion {
  const Node& node;
  int index;
  const double *axis, *origin;
  double linear[3], angular[3];

  // Velocity of another point of the node along a direction.
  double velocity_along(const double* direction, const double* point) const {
    double linear_velocity[3], angular_velocity[3];
    velocity(node, axis, origin, point, linear_velocity, angular_velocity);
    return dot(direction, linear_velocity);
  }
};

// Target types.
struct PointTarget {
  static constexpr int TARGET_SIZE = 3;

  // Divides the target by the length of the chain.
  static void convert_target(double* target, const double*, double length) {
    for (int i = 0; i < 3; ++i) target[i] /= length;
  }
};

struct RotationTarget {
  static constexpr int TARGET_SIZE = 4;

  // Normalises the target and transforms it to the node's frame; `frame` is node_from_joint. Scales
  // it first, so that neither tiny nor huge numbers under- or overflow.
  static void convert_target(double* q, const double* frame, double) {
    const double inverse[4] = {-frame[0], -frame[1], -frame[2], frame[3]};
    const double largest =
        std::max({std::fabs(q[0]), std::fabs(q[1]), std::fabs(q[2]), std::fabs(q[3])});
    if (largest > 0) {
      for (int i = 0; i < 4; ++i) q[i] /= largest;
      normalize(q);
    } else {
      q[0] = q[1] = q[2] = 0, q[3] = 1;
    }
    product(q, inverse, q);
  }
};

// Each kind has, besides its name as in Python:
// RESIDUAL_COUNT: number of residuals
// IS_LENGTH: whether the error is a length, else an angle
// NEEDS_LIMB: whether it needs the nodes of a limb
// measure: computes the weighted residuals and returns the error
// target_from_pose: computes the target that the current pose reaches
// JacobianTerms: prepared once per pose; `add` adds the effect of a motion, times weight and gain,
// to a column of the Jacobian
// add_alignment: for cyclic coordinate descent, if supported: adds the goal to the sums of a joint
// at `origin`
struct Position : PointTarget {
  static constexpr const char* NAME = "position";
  static constexpr int RESIDUAL_COUNT = 3;
  static constexpr bool IS_LENGTH = true, NEEDS_LIMB = false;

  static double measure(double weight, const GoalView& view, const double* target, double* r) {
    for (int i = 0; i < 3; ++i) r[i] = target[i] - view.point[i];
    const double error = length(r);
    for (int i = 0; i < 3; ++i) r[i] *= weight;
    return error;
  }

  static void target_from_pose(const GoalView& view, double* target) {
    std::copy(view.point, view.point + 3, target);
  }

  struct JacobianTerms {
    void prepare(const GoalView&, const double*) {}
    void add(const AxisMotion& motion, double scale, double* column) const {
      for (int i = 0; i < 3; ++i) column[i] += scale * motion.linear[i];
    }
  };

  static void add_alignment(double weight, const GoalView& view, const double* target,
                            const double* origin, AlignmentSums& sum) {
    double from[3], to[3];
    for (int i = 0; i < 3; ++i) from[i] = view.point[i] - origin[i], to[i] = target[i] - origin[i];
    sum.add(weight, from, to);
  }
};

struct Orientation : RotationTarget {
  static constexpr const char* NAME = "orientation";
  static constexpr int RESIDUAL_COUNT = 3;
  static constexpr bool IS_LENGTH = false, NEEDS_LIMB = false;

  // The rotation from the current to the target orientation.
  static void remaining_rotation(const GoalView& view, const double* target, double* out) {
    double desired_rotation[9], inverse[9];
    to_matrix(target, desired_rotation);
    for (int i = 0; i < 9; ++i) inverse[i] = view.rotation[3 * (i % 3) + i / 3];
    multiply(desired_rotation, inverse, out);
  }

  static double measure(double weight, const GoalView& view, const double* target, double* r) {
    double remaining_matrix[9];
    remaining_rotation(view, target, remaining_matrix);
    logarithm_of_matrix(remaining_matrix, r);
    const double error = length(r);
    for (int i = 0; i < 3; ++i) r[i] *= weight;
    return error;
  }

  static void target_from_pose(const GoalView& view, double* target) {
    double rotation_vector[3];
    logarithm_of_matrix(view.rotation, rotation_vector);
    exponential(rotation_vector, target);
  }

  struct JacobianTerms {
    void prepare(const GoalView&, const double*) {}
    void add(const AxisMotion& motion, double scale, double* column) const {
      for (int i = 0; i < 3; ++i) column[i] += scale * motion.angular[i];
    }
  };

  static void add_alignment(double weight, const GoalView& view, const double* target,
                            const double*, AlignmentSums& sum) {
    double remaining_matrix[9];
    remaining_rotation(view, target, remaining_matrix);
    sum.add(weight, remaining_matrix);
  }
};

struct Aim : PointTarget {
  static constexpr const char* NAME = "aim";
  static constexpr int RESIDUAL_COUNT = 2;
  static constexpr bool IS_LENGTH = false, NEEDS_LIMB = false;

  // The rotation that takes the aim axis to its target: its angle and unit axis.
  struct AimRotation {
    double direction[3], desired_direction[3], axis[3];
    double distance, angle;
  };

  static AimRotation aim_rotation(const GoalView& view, const double* target) {
    AimRotation aim;
    rotate(view.rotation, view.aim_axis, aim.direction);
    for (int i = 0; i < 3; ++i) aim.desired_direction[i] = target[i] - view.point[i];
    aim.distance = length(aim.desired_direction);
    if (aim.distance < 1e-12) {
      std::copy(aim.direction, aim.direction + 3, aim.desired_direction);
      aim.distance = 1;
    } else {
      for (double& x : aim.desired_direction) x /= aim.distance;
    }
    cross(aim.direction, aim.desired_direction, aim.axis);
    const double sine = length(aim.axis);
    aim.angle = std::atan2(sine, dot(aim.direction, aim.desired_direction));
    double unused[3];
    if (sine < 1e-12)
      orthogonal_basis(aim.direction, aim.axis, unused);
    else
      for (double& x : aim.axis) x /= sine;
    return aim;
  }

  static double measure(double weight, const GoalView& view, const double* target, double* r) {
    const AimRotation aim = aim_rotation(view, target);
    double u[3], v[3];
    orthogonal_basis(aim.direction, u, v);
    r[0] = weight * aim.angle * dot(aim.axis, u);
    r[1] = weight * aim.angle * dot(aim.axis, v);
    return aim.angle;
  }

  static void target_from_pose(const GoalView& view, double* target) {
    double direction[3];
    rotate(view.rotation, view.aim_axis, direction);
    for (int i = 0; i < 3; ++i) target[i] = view.point[i] + direction[i];
  }

  struct JacobianTerms {
    AimRotation aim;
    double u[3], v[3];

    void prepare(const GoalView& view, const double* target) {
      aim = aim_rotation(view, target);
      orthogonal_basis(aim.direction, u, v);
    }
    void add(const AxisMotion& motion, double scale, double* column) const {
      double direction_velocity[3];
      cross(aim.desired_direction, motion.linear, direction_velocity);
      for (int i = 0; i < 3; ++i)
        direction_velocity[i] = motion.angular[i] + direction_velocity[i] / aim.distance;
      column[0] += scale * dot(direction_velocity, u);
      column[1] += scale * dot(direction_velocity, v);
    }
  };

  static void add_alignment(double weight, const GoalView& view, const double* target,
                            const double*, AlignmentSums& sum) {
    const AimRotation aim = aim_rotation(view, target);
    sum.add(weight, aim.direction, aim.desired_direction);
  }
};

struct Pole : PointTarget {
  static constexpr const char* NAME = "pole";
  static constexpr int RESIDUAL_COUNT = 1;
  static constexpr bool IS_LENGTH = false, NEEDS_LIMB = true;

  // The half planes of a limb and of its pole, projected along the limb.
  struct Bend {
    double axis[3], middle[3], pole[3];  // `middle` and `pole` are perpendicular to the axis
    double span, middle_distance, pole_distance, angle;
    bool is_defined;
  };

  static Bend compute_bend(const GoalView& view, const double* target) {
    Bend bend;
    for (int i = 0; i < 3; ++i) {
      bend.axis[i] = view.point[i] - view.root_position[i];
      bend.middle[i] = view.middle_position[i] - view.root_position[i];
      bend.pole[i] = target[i] - view.root_position[i];
    }
    bend.span = length(bend.axis);
    bend.is_defined = bend.span > 1e-9;
    if (!bend.is_defined) return bend;
    for (double& x : bend.axis) x /= bend.span;
    bend.middle_distance = dot(bend.axis, bend.middle);
    bend.pole_distance = dot(bend.axis, bend.pole);
    for (int i = 0; i < 3; ++i) {
      bend.middle[i] -= bend.middle_distance * bend.axis[i];
      bend.pole[i] -= bend.pole_distance * bend.axis[i];
    }
    bend.is_defined = length(bend.middle) > 1e-9 && length(bend.pole) > 1e-9;
    bend.angle =
        std::atan2(triple_product(bend.axis, bend.middle, bend.pole), dot(bend.middle, bend.pole));
    return bend;
  }

  static double measure(double weight, const GoalView& view, const double* target, double* r) {
    const Bend bend = compute_bend(view, target);
    r[0] = bend.is_defined ? weight * bend.angle : 0;
    return bend.is_defined ? std::fabs(bend.angle) : 0;
  }

  static void target_from_pose(const GoalView& view, double* target) {
    std::copy(view.middle_position, view.middle_position + 3, target);
  }

  // Derivatives of Bend::angle by the points of a limb.
  struct JacobianTerms {
    GoalView view;
    bool is_defined;
    double root[3], middle[3], tip[3];

    void prepare(const GoalView& chain_view, const double* target) {
      view = chain_view;
      const Bend bend = compute_bend(view, target);
      is_defined = bend.is_defined;
      if (!is_defined) return;
      double middle_normal[3], pole_normal[3];
      cross(bend.axis, bend.middle, middle_normal);
      cross(bend.axis, bend.pole, pole_normal);
      const double middle_square = dot(bend.middle, bend.middle),
                   pole_square = dot(bend.pole, bend.pole);
      const double middle_fraction = bend.middle_distance / bend.span;
      const double pole_fraction = bend.pole_distance / bend.span;
      for (int i = 0; i < 3; ++i) {
        const double a = middle_normal[i] / middle_square, b = pole_normal[i] / pole_square;
        middle[i] = -a;
        tip[i] = middle_fraction * a - pole_fraction * b;
        root[i] = (1 - middle_fraction) * a - (1 - pole_fraction) * b;
      }
    }
    void add(const AxisMotion& motion, double scale, double* column) const {
      if (!is_defined) return;
      double angle_rate = dot(tip, motion.linear);
      if (motion.index <= view.middle)
        angle_rate += motion.velocity_along(middle, view.middle_position);
      if (motion.index <= view.root) angle_rate += motion.velocity_along(root, view.root_position);
      column[0] -= scale * angle_rate;
    }
  };
};

// In the order of rows, weights and errors, as in the table of Python.
using GoalKinds = std::tuple<Position, Orientation, Aim, Pole>;
constexpr int COMPONENT_COUNT = std::tuple_size_v<GoalKinds>;

// Calls f<Kind>(index) for each kind.
template <class F>
constexpr void for_each_kind(F&& f) {
  [&]<std::size_t... K>(std::index_sequence<K...>) {
    (f.template operator()<std::tuple_element_t<K, GoalKinds>>(K), ...);
  }(std::make_index_sequence<COMPONENT_COUNT>{});
}

// Index of a kind.
template <class Kind>
constexpr int component_of() {
  int match = -1;
  for_each_kind([&]<class Other>(int component) {
    if (std::is_same_v<Kind, Other>) match = component;
  });
  return match;
}

// Cumulative sums of a number of each kind, starting at 0.
template <class F>
constexpr std::array<int, COMPONENT_COUNT + 1> cumulative_sums(F&& count) {
  std::array<int, COMPONENT_COUNT + 1> sums{};
  for_each_kind([&]<class Kind>(int component) {
    sums[component + 1] = sums[component] + count.template operator()<Kind>();
  });
  return sums;
}

// Offset of each kind's target in a row of targets. The targets are followed by factors of the
// weights: with a factor of 0, the residuals are 0.
constexpr std::array<int, COMPONENT_COUNT + 1> TARGET_OFFSETS =
    cumulative_sums([]<class Kind>() { return Kind::TARGET_SIZE; });
constexpr int WEIGHTS_OFFSET = TARGET_OFFSETS[COMPONENT_COUNT];
constexpr int TARGET_WIDTH = WEIGHTS_OFFSET + COMPONENT_COUNT;
// Number of rows of a goal with all kinds.
constexpr int MAX_GOAL_ROWS =
    cumulative_sums([]<class Kind>() { return Kind::RESIDUAL_COUNT; })[COMPONENT_COUNT];
// Whether the error of each kind is a length, else an angle.
constexpr std::array<bool, COMPONENT_COUNT> IS_LENGTH = [] {
  std::array<bool, COMPONENT_COUNT> is_length{};
  for_each_kind([&]<class Kind>(int component) { is_length[component] = Kind::IS_LENGTH; });
  return is_length;
}();

template <class Kind>
concept Alignable = requires(const GoalView& view, const double* vector, AlignmentSums& sum) {
  Kind::add_alignment(1.0, view, vector, vector, sum);
};

}  // namespace animtool::ik
