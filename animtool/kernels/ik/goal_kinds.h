// The kinds of goals: residuals, Jacobians, and use in solvers.
//
// A residual r is target minus value, so that r(q + d) = r(q) - J d to first order, and the
// gradient of the cost |r|^2 / 2 is exactly -J^T r: rotations are compared by their rotation
// vector in the world, separately from positions.
#pragma once

#include <array>
#include <tuple>
#include <utility>

#include "ik/chain.h"

namespace animtool::ik {

// The pose of the chain as seen by a goal kind.
struct View {
  const double* rotation;  // of the goal's node
  const double* point;
  const double* aim_axis;        // in the node's frame
  int root, middle;              // nodes of the limb, or -1
  const double *origin, *joint;  // of its root and middle; null without a limb
};

// Velocity of a goal's point and frame per unit motion about an axis of a node.
struct Motion {
  const Node& node;
  int index;
  const double *axis, *origin;
  double linear[3], angular[3];

  // The same for another point of the node.
  double along(const double* direction, const double* point) const {
    double moved[3], turned[3];
    velocity(node, axis, origin, point, moved, turned);
    return dot(direction, moved);
  }
};

// Target types.
struct PointTarget {
  static constexpr int WIDTH = 3;

  // Scales it by the length of the chain.
  static void to_chain(double* target, const double*, double length) {
    for (int i = 0; i < 3; ++i) target[i] /= length;
  }
};

struct RotationTarget {
  static constexpr int WIDTH = 4;

  // Normalises it and transforms it to the node's frame; `frame` is node_from_joint. Scales
  // first, so that neither tiny nor huge numbers under- or overflow.
  static void to_chain(double* q, const double* frame, double) {
    const double back[4] = {-frame[0], -frame[1], -frame[2], frame[3]};
    const double largest =
        std::max({std::fabs(q[0]), std::fabs(q[1]), std::fabs(q[2]), std::fabs(q[3])});
    if (largest > 0) {
      for (int i = 0; i < 4; ++i) q[i] /= largest;
      normalize(q);
    } else {
      q[0] = q[1] = q[2] = 0, q[3] = 1;
    }
    product(q, back, q);
  }
};

// Each kind has, besides its name as in Python:
//   ROWS     residuals
//   METRIC   the error is a length, else an angle
//   LIMB     it needs the nodes of a limb
//   measure  writes the weighted residuals and returns the error
//   keep     writes the target that the current pose reaches
//   Slopes   built once per pose; `add` adds the effect of a motion to a column of the
//            Jacobian; `scale` is its weight times gain
//   pull     for cyclic coordinate descent, if supported: adds the goal's pull on a joint at
//            `origin`
struct Position : PointTarget {
  static constexpr const char* NAME = "position";
  static constexpr int ROWS = 3;
  static constexpr bool METRIC = true, LIMB = false;

  static double measure(double weight, const View& view, const double* target, double* r) {
    for (int i = 0; i < 3; ++i) r[i] = target[i] - view.point[i];
    const double error = length(r);
    for (int i = 0; i < 3; ++i) r[i] *= weight;
    return error;
  }

  static void target_from_pose(const View& view, double* target) {
    std::copy(view.point, view.point + 3, target);
  }

  struct Slopes {
    void prepare(const View&, const double*) {}
    void add(const Motion& motion, double scale, double* column) const {
      for (int i = 0; i < 3; ++i) column[i] += scale * motion.linear[i];
    }
  };

  static void pull(double weight, const View& view, const double* target, const double* origin,
                   Pull& sum) {
    double from[3], to[3];
    for (int i = 0; i < 3; ++i) from[i] = view.point[i] - origin[i], to[i] = target[i] - origin[i];
    sum.add(weight, from, to);
  }
};

struct Orientation : RotationTarget {
  static constexpr const char* NAME = "orientation";
  static constexpr int ROWS = 3;
  static constexpr bool METRIC = false, LIMB = false;

  // The remaining rotation.
  static void remaining_rotation(const View& view, const double* target, double* out) {
    double desired[9], transposed[9];
    to_matrix(target, desired);
    for (int i = 0; i < 9; ++i) transposed[i] = view.rotation[3 * (i % 3) + i / 3];
    multiply(desired, transposed, out);
  }

  static double measure(double weight, const View& view, const double* target, double* r) {
    double remaining[9];
    remaining_rotation(view, target, remaining);
    logarithm_of_matrix(remaining, r);
    const double error = length(r);
    for (int i = 0; i < 3; ++i) r[i] *= weight;
    return error;
  }

  static void target_from_pose(const View& view, double* target) {
    double remaining[3];
    logarithm_of_matrix(view.rotation, remaining);
    exponential(remaining, target);
  }

  struct Slopes {
    void prepare(const View&, const double*) {}
    void add(const Motion& motion, double scale, double* column) const {
      for (int i = 0; i < 3; ++i) column[i] += scale * motion.angular[i];
    }
  };

  static void pull(double weight, const View& view, const double* target, const double*,
                   Pull& sum) {
    double remaining[9];
    remaining_rotation(view, target, remaining);
    sum.add(weight, remaining);
  }
};

struct Aim : PointTarget {
  static constexpr const char* NAME = "aim";
  static constexpr int ROWS = 2;
  static constexpr bool METRIC = false, LIMB = false;

  // The rotation that takes the aim axis to its target: angle and unit axis.
  struct AimRotation {
    double direction[3], desired[3], axis[3];
    double distance, angle;
  };

  static AimRotation aim_rotation(const View& view, const double* target) {
    AimRotation aim;
    rotate(view.rotation, view.aim_axis, aim.direction);
    for (int i = 0; i < 3; ++i) aim.desired[i] = target[i] - view.point[i];
    aim.distance = length(aim.desired);
    if (aim.distance < 1e-12) {
      std::copy(aim.direction, aim.direction + 3, aim.desired);
      aim.distance = 1;
    } else {
      for (double& x : aim.desired) x /= aim.distance;
    }
    cross(aim.direction, aim.desired, aim.axis);
    const double sine = length(aim.axis);
    aim.angle = std::atan2(sine, dot(aim.direction, aim.desired));
    double other[3];
    if (sine < 1e-12)
      across(aim.direction, aim.axis, other);
    else
      for (double& x : aim.axis) x /= sine;
    return aim;
  }

  static double measure(double weight, const View& view, const double* target, double* r) {
    const AimRotation aim = aim_rotation(view, target);
    double u[3], v[3];
    across(aim.direction, u, v);
    r[0] = weight * aim.angle * dot(aim.axis, u);
    r[1] = weight * aim.angle * dot(aim.axis, v);
    return aim.angle;
  }

  static void target_from_pose(const View& view, double* target) {
    double direction[3];
    rotate(view.rotation, view.aim_axis, direction);
    for (int i = 0; i < 3; ++i) target[i] = view.point[i] + direction[i];
  }

  struct Slopes {
    AimRotation aim;
    double u[3], v[3];

    void prepare(const View& view, const double* target) {
      aim = aim_rotation(view, target);
      across(aim.direction, u, v);
    }
    void add(const Motion& motion, double scale, double* column) const {
      double turned[3];
      cross(aim.desired, motion.linear, turned);
      for (int i = 0; i < 3; ++i) turned[i] = motion.angular[i] + turned[i] / aim.distance;
      column[0] += scale * dot(turned, u);
      column[1] += scale * dot(turned, v);
    }
  };

  static void pull(double weight, const View& view, const double* target, const double*,
                   Pull& sum) {
    const AimRotation aim = aim_rotation(view, target);
    sum.add(weight, aim.direction, aim.desired);
  }
};

struct Pole : PointTarget {
  static constexpr const char* NAME = "pole";
  static constexpr int ROWS = 1;
  static constexpr bool METRIC = false, LIMB = true;

  // The half planes of a limb and of its pole, projected along the limb.
  struct Bend {
    double axis[3], middle[3], pole[3];  // the last two at right angles to the axis
    double span, middle_along, pole_along, angle;
    bool is_defined;
  };

  static Bend bend_of(const View& view, const double* target) {
    Bend limb;
    for (int i = 0; i < 3; ++i) {
      limb.axis[i] = view.point[i] - view.origin[i];
      limb.middle[i] = view.joint[i] - view.origin[i];
      limb.pole[i] = target[i] - view.origin[i];
    }
    limb.span = length(limb.axis);
    limb.is_defined = limb.span > 1e-9;
    if (!limb.is_defined) return limb;
    for (double& x : limb.axis) x /= limb.span;
    limb.middle_along = dot(limb.axis, limb.middle);
    limb.pole_along = dot(limb.axis, limb.pole);
    for (int i = 0; i < 3; ++i) {
      limb.middle[i] -= limb.middle_along * limb.axis[i];
      limb.pole[i] -= limb.pole_along * limb.axis[i];
    }
    limb.is_defined = length(limb.middle) > 1e-9 && length(limb.pole) > 1e-9;
    limb.angle = std::atan2(triple(limb.axis, limb.middle, limb.pole), dot(limb.middle, limb.pole));
    return limb;
  }

  static double measure(double weight, const View& view, const double* target, double* r) {
    const Bend limb = bend_of(view, target);
    r[0] = limb.is_defined ? weight * limb.angle : 0;
    return limb.is_defined ? std::fabs(limb.angle) : 0;
  }

  static void target_from_pose(const View& view, double* target) {
    std::copy(view.joint, view.joint + 3, target);
  }

  // Derivatives of Bend::angle by the points of a limb.
  struct Slopes {
    View view;
    bool is_defined;
    double root[3], middle[3], tip[3];

    void prepare(const View& chain_view, const double* target) {
      view = chain_view;
      const Bend limb = bend_of(view, target);
      is_defined = limb.is_defined;
      if (!is_defined) return;
      double by_middle[3], by_pole[3];
      cross(limb.axis, limb.middle, by_middle);
      cross(limb.axis, limb.pole, by_pole);
      const double m = dot(limb.middle, limb.middle), p = dot(limb.pole, limb.pole);
      const double at_middle = limb.middle_along / limb.span;
      const double at_pole = limb.pole_along / limb.span;
      for (int i = 0; i < 3; ++i) {
        const double a = by_middle[i] / m, b = by_pole[i] / p;
        middle[i] = -a;
        tip[i] = at_middle * a - at_pole * b;
        root[i] = (1 - at_middle) * a - (1 - at_pole) * b;
      }
    }
    void add(const Motion& motion, double scale, double* column) const {
      if (!is_defined) return;
      double rate = dot(tip, motion.linear);
      if (motion.index <= view.middle) rate += motion.along(middle, view.joint);
      if (motion.index <= view.root) rate += motion.along(root, view.origin);
      column[0] -= scale * rate;
    }
  };
};

// In the order of rows, weights and errors, as in Python's table.
using Kinds = std::tuple<Position, Orientation, Aim, Pole>;
constexpr int PARTS = std::tuple_size_v<Kinds>;

// Calls f<Kind>(number) for each kind.
template <class F>
constexpr void each_kind(F&& f) {
  [&]<std::size_t... K>(std::index_sequence<K...>) {
    (f.template operator()<std::tuple_element_t<K, Kinds>>(K), ...);
  }(std::make_index_sequence<PARTS>{});
}

template <class Kind>
constexpr int part_of() {
  int match = -1;
  each_kind([&]<class Other>(int part) {
    if (std::is_same_v<Kind, Other>) match = part;
  });
  return match;
}

template <class F>
constexpr std::array<int, PARTS + 1> sums(F&& count) {
  std::array<int, PARTS + 1> ends{};
  each_kind([&]<class Kind>(int part) {
    ends[part + 1] = ends[part] + count.template operator()<Kind>();
  });
  return ends;
}

// Offset of each kind's target in a row of targets. The targets are followed by factors of the
// weights: with a factor of 0, the residuals are 0.
constexpr std::array<int, PARTS + 1> COLUMNS = sums([]<class Kind>() { return Kind::WIDTH; });
constexpr int WEIGHTS = COLUMNS[PARTS];
constexpr int TARGET_WIDTH = WEIGHTS + PARTS;
// Number of rows of a goal with all kinds.
constexpr int MAX_GOAL_ROWS = sums([]<class Kind>() { return Kind::ROWS; })[PARTS];
constexpr std::array<bool, PARTS> METRIC = [] {
  std::array<bool, PARTS> metric{};
  each_kind([&]<class Kind>(int part) { metric[part] = Kind::METRIC; });
  return metric;
}();

template <class Kind>
concept Pulling =
    requires(const View& view, const double* at, Pull& sum) { Kind::pull(1.0, view, at, at, sum); };

}  // namespace animtool::ik
