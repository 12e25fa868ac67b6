// Closed form of arms with six pins, with a spherical wrist or three parallel axes.
//
// Angles are solved one after the other by geometric subproblems: the rotation that takes one
// vector to another (1), two such rotations (2), a rotation after which a vector has a given
// component along another (4), or a given distance from it (3) (B. Paden, Kinematics and control of
// robot manipulators, 1986; A. Elias, J. Wen, IK-Geo, 2022). Everything is in the frame of the pose
// with zero angles, where axis i is the line through `point` along `axis`. Newton's method removes
// rounding errors, and errors of axes in files that intersect only approximately.
//
// Limits of the method: if axes intersect or are parallel only approximately, a branch next to a
// singular pose may be missed. If axes are collinear, or the wrist is on the first axis, there are
// infinitely many solutions; the free angle is that of the start.
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "ik/closed.h"
#include "ik/limits.h"
#include "ik/linear.h"

namespace animtool::ik {

namespace {

// Tolerance of the intersection of axes, as a fraction of the length, and of parallel axes [rad].
constexpr double ARM_TOLERANCE = 1e-3;
// Vectors shorter than this have no direction.
constexpr double ARM_MIN_LENGTH = 1e-10;
// Error at which Newton's method stops, and its largest number of steps.
constexpr double ARM_NEWTON_TOLERANCE = 1e-15;
constexpr int ARM_NEWTON_STEPS = 8;
// Pivots below this fraction of the first pivot count as zero.
constexpr double ARM_MIN_PIVOT = 1e-11;

using Triple = std::array<double, 3>;

Triple minus(const Triple& a, const Triple& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

Triple plus(const Triple& a, const Triple& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }

Triple times(double scale, const Triple& a) { return {scale * a[0], scale * a[1], scale * a[2]}; }

double dot_product(const Triple& a, const Triple& b) { return dot(a.data(), b.data()); }

Triple cross_product(const Triple& a, const Triple& b) {
  Triple c;
  cross(a.data(), b.data(), c.data());
  return c;
}

double norm(const Triple& a) { return length(a.data()); }

// Rotates a vector about a unit axis.
Triple rotate_about(const Triple& axis, double angle, const Triple& v) {
  const double cosine = std::cos(angle), sine = std::sin(angle),
               axial = (1 - cosine) * dot_product(axis, v);
  const Triple perpendicular = cross_product(axis, v);
  Triple out;
  for (int i = 0; i < 3; ++i) out[i] = cosine * v[i] + sine * perpendicular[i] + axial * axis[i];
  return out;
}

// Solutions of an equation: none, one or two angles. If all angles are solutions, the free angle of
// the start is returned.
struct AngleSolutions {
  int count = 0;
  double values[2] = {};
};

// Subproblem 1: the angle of the rotation from p to q; `free_angle` if they are on the axis.
double angle_between(const Triple& axis, const Triple& p, const Triple& q, double free_angle) {
  const Triple p_side = cross_product(axis, p), q_side = cross_product(axis, q);
  if (std::min(norm(p_side), norm(q_side)) < ARM_MIN_LENGTH) return free_angle;
  return std::atan2(dot_product(axis, cross_product(p_side, q_side)), dot_product(p_side, q_side));
}

// Subproblem 4: angles of rotations of p about an axis after which its component along h is d. If d
// is out of range by up to `range_tolerance`, it is clamped.
AngleSolutions angles_to_component(const Triple& axis, const Triple& p, const Triple& h, double d,
                                   double range_tolerance, double free_angle) {
  const double constant_part = dot_product(h, axis) * dot_product(axis, p);
  const double cosine_part = dot_product(h, p) - constant_part,
               sine_part = dot_product(h, cross_product(axis, p)), remainder = d - constant_part;
  const double amplitude = std::hypot(cosine_part, sine_part);
  if (amplitude < ARM_MIN_LENGTH)
    return std::fabs(remainder) < ARM_MIN_LENGTH + range_tolerance ? AngleSolutions{1, {free_angle}}
                                                                   : AngleSolutions{};
  const double cosine = remainder / amplitude;
  if (std::fabs(cosine) > 1 + range_tolerance / amplitude) return {};
  const double middle = std::atan2(sine_part, cosine_part),
               clamped_cosine = std::clamp(cosine, -1.0, 1.0);
  const double half_width =
      std::atan2(std::sqrt((1 - clamped_cosine) * (1 + clamped_cosine)), clamped_cosine);
  return {2, {middle + half_width, middle - half_width}};
}

// Subproblem 3: angles of rotations of p about an axis after which it has a given distance from q.
AngleSolutions angles_to_distance(const Triple& axis, const Triple& p, const Triple& q,
                                  double distance, double range_tolerance, double free_angle) {
  return angles_to_component(axis, p, q,
                             (dot_product(p, p) + dot_product(q, q) - distance * distance) / 2,
                             range_tolerance, free_angle);
}

// Subproblem 2: angles of rotations of p and q about two axes that take them to the same vector.
template <class Function>
void angles_to_common_vector(const Triple& first_axis, const Triple& p, const Triple& second_axis,
                             const Triple& q, double range_tolerance, double first_free_angle,
                             double second_free_angle, Function&& function) {
  const double axis_dot = dot_product(first_axis, second_axis),
               squared_sine = 1 - axis_dot * axis_dot;
  const double p_component = dot_product(first_axis, p), q_component = dot_product(second_axis, q);
  const double a = (p_component - axis_dot * q_component) / squared_sine,
               b = (q_component - axis_dot * p_component) / squared_sine;
  const Triple normal = cross_product(first_axis, second_axis);
  const Triple in_axis_plane = plus(times(a, first_axis), times(b, second_axis));
  const double remainder = dot_product(p, p) - dot_product(in_axis_plane, in_axis_plane);
  if (remainder < -range_tolerance) return;
  const double height = std::sqrt(std::max(remainder, 0.0) / squared_sine);
  for (const double sign : {1.0, -1.0}) {
    const Triple common_vector = plus(in_axis_plane, times(sign * height, normal));
    function(angle_between(first_axis, p, common_vector, first_free_angle),
             angle_between(second_axis, q, common_vector, second_free_angle));
  }
}

// The line of an axis.
struct Line {
  Triple axis, point;
};

// Sine of the angle between two joint axes.
double sine_between(const Line& a, const Line& b) { return norm(cross_product(a.axis, b.axis)); }

// Computes the point of line a nearest to line b; returns their distance.
double nearest_point(const Line& a, const Line& b, Triple& point) {
  const Triple offset = minus(b.point, a.point);
  const double axis_dot = dot_product(a.axis, b.axis), squared_sine = 1 - axis_dot * axis_dot;
  if (squared_sine < ARM_TOLERANCE) return HUGE_VAL;
  const double distance =
      (dot_product(offset, a.axis) - axis_dot * dot_product(offset, b.axis)) / squared_sine;
  point = plus(a.point, times(distance, a.axis));
  const Triple difference = minus(point, b.point);
  return norm(minus(difference, times(dot_product(difference, b.axis), b.axis)));
}

// Whether a point is on a line, within the tolerance.
bool is_on_line(const Triple& point, const Line& line) {
  const Triple offset = minus(point, line.point);
  return norm(minus(offset, times(dot_product(offset, line.axis), line.axis))) < ARM_TOLERANCE;
}

// Methods that position the wrist by the first three axes: two neighbouring axes, 1 and 2 or 2 and
// 3, are parallel or intersect.
enum class WristMethod { NONE, PARALLEL_23, INTERSECT_23, INTERSECT_12, PARALLEL_12 };

// Geometry of an arm at zero angles.
struct ArmGeometry {
  ArmKind kind = ArmKind::NONE;
  WristMethod method = WristMethod::NONE;
  Line joint_axes[ARM_PINS];
  Triple wrist;         // intersection of the last three axes, or of the last two
  Triple intersection;  // intersection of two of the first three axes
  Triple tip;
  double zero_rotation[9];  // rotation of the last node
};

// Whether a task has the nodes and the goal of an arm.
bool is_arm(const Task& task) {
  if (task.chain.nodes.size() != ARM_PINS || task.goals.size() != 1) return false;
  for (std::size_t n = 0; n < ARM_PINS; ++n) {
    const Node& node = task.chain.nodes[n];
    const bool is_independent =
        node.gain == 1 && node.shift == 0 && !node.is_driven && node.program < 0;
    if (node.kind != Kind::PIN || node.parent != static_cast<int>(n) - 1 || !is_independent)
      return false;
  }
  const Goal& goal = task.goals[0];
  constexpr int position = component_of<Position>(), orientation = component_of<Orientation>();
  for (int component = 0; component < COMPONENT_COUNT; ++component)
    if ((goal.weights[component] > 0) != (component == position || component == orientation))
      return false;
  return goal.node == static_cast<int>(ARM_PINS) - 1 && !(task.rest_weight > 0);
}

// The method that positions the wrist.
WristMethod find_wrist_method(ArmGeometry& arm) {
  const Line* joint_axes = arm.joint_axes;
  if (sine_between(joint_axes[0], joint_axes[1]) > ARM_TOLERANCE) {
    if (sine_between(joint_axes[1], joint_axes[2]) < ARM_TOLERANCE) return WristMethod::PARALLEL_23;
    if (nearest_point(joint_axes[0], joint_axes[1], arm.intersection) < ARM_TOLERANCE)
      return WristMethod::INTERSECT_12;
  } else if (sine_between(joint_axes[1], joint_axes[2]) > ARM_TOLERANCE) {
    return WristMethod::PARALLEL_12;
  }
  return nearest_point(joint_axes[1], joint_axes[2], arm.intersection) < ARM_TOLERANCE
             ? WristMethod::INTERSECT_23
             : WristMethod::NONE;
}

// Reads the geometry of a task's arm; its kind is NONE without a closed form.
ArmGeometry analyze_arm(const Task& task) {
  ArmGeometry arm;
  if (!is_arm(task)) return arm;
  Frames frames(task.chain);
  const double zero_angles[ARM_PINS] = {};
  compute_frames(task.chain, zero_angles, frames);
  for (std::size_t n = 0; n < ARM_PINS; ++n) {
    std::copy_n(&frames.axes[9 * n], 3, arm.joint_axes[n].axis.data());
    std::copy_n(&frames.origins[3 * n], 3, arm.joint_axes[n].point.data());
  }
  std::copy_n(&frames.rotations[9 * (ARM_PINS - 1)], 9, arm.zero_rotation);
  rotate(arm.zero_rotation, task.goals[0].offset, arm.tip.data());
  arm.tip = plus(arm.tip, arm.joint_axes[ARM_PINS - 1].point);
  if (!(nearest_point(arm.joint_axes[4], arm.joint_axes[5], arm.wrist) < ARM_TOLERANCE)) return arm;
  const Line* joint_axes = arm.joint_axes;
  if (sine_between(joint_axes[1], joint_axes[2]) < ARM_TOLERANCE &&
      sine_between(joint_axes[2], joint_axes[3]) < ARM_TOLERANCE &&
      sine_between(joint_axes[0], joint_axes[1]) > ARM_TOLERANCE &&
      sine_between(joint_axes[3], joint_axes[4]) > ARM_TOLERANCE) {
    arm.kind = ArmKind::PARALLEL;
    return arm;
  }
  const bool has_spherical_wrist = is_on_line(arm.wrist, joint_axes[3]) &&
                                   sine_between(joint_axes[3], joint_axes[4]) > ARM_TOLERANCE;
  arm.method = has_spherical_wrist ? find_wrist_method(arm) : WristMethod::NONE;
  if (arm.method != WristMethod::NONE) arm.kind = ArmKind::WRIST;
  return arm;
}

class SixPins : public Arm {
 public:
  SixPins(const Task& task, const ArmGeometry& arm, double length_tolerance, double angle_tolerance)
      : task_(task),
        arm_(arm),
        tolerances_{length_tolerance, angle_tolerance},
        state_(task),
        linear_(task) {}

  bool depends_on_start() const override { return true; }

  bool solve(const double* start, const double* target, const double*, double, double* q,
             double* errors) override {
    const std::size_t count = find_branches(start, target);
    for (std::size_t i = 0; i < count; ++i) {
      if (!refine(branches_[order_[i]].angles, target)) continue;
      std::copy(state_.q.begin(), state_.q.end(), q);
      std::copy(state_.errors.begin(), state_.errors.end(), errors);
      return true;
    }
    return false;
  }

  std::size_t branches(const double* start, const double* target, double* poses) override {
    const std::size_t count = find_branches(start, target);
    std::size_t pose_count = 0;
    for (std::size_t i = 0; i < count; ++i) {
      if (!refine(branches_[order_[i]].angles, target)) continue;
      double* pose = poses + ARM_PINS * pose_count;
      std::copy(state_.q.begin(), state_.q.end(), pose);
      pose_count += !is_duplicate(poses, pose_count, pose);
    }
    return pose_count;
  }

 private:
  struct Branch {
    double angles[ARM_PINS], distance;
  };

  // Whether a pose equals an earlier one: branches merge at a singular pose.
  static bool is_duplicate(const double* poses, std::size_t count, const double* pose) {
    for (std::size_t i = 0; i < count; ++i) {
      double largest = 0;
      for (std::size_t k = 0; k < ARM_PINS; ++k)
        largest = std::max(largest, std::fabs(poses[ARM_PINS * i + k] - pose[k]));
      if (largest < 1e-7) return true;
    }
    return false;
  }

  // Solves the equations; returns the number of solutions within the limits, sorted by distance
  // from the start.
  std::size_t find_branches(const double* start, const double* target) {
    branch_count_ = 0;
    constexpr int position = component_of<Position>(), orientation = component_of<Orientation>();
    const double* weights = target + WEIGHTS_OFFSET;
    if (!(weights[position] > 0) || !(weights[orientation] > 0)) return 0;
    start_ = start;
    double goal[9], inverse_zero[9];
    to_matrix(target + TARGET_OFFSETS[orientation], goal);
    for (int i = 0; i < 9; ++i) inverse_zero[i] = arm_.zero_rotation[3 * (i % 3) + i / 3];
    multiply(goal, inverse_zero, goal_rotation_);
    const Triple tip_to_wrist = minus(arm_.wrist, arm_.tip);
    rotate(goal_rotation_, tip_to_wrist.data(), wrist_target_.data());
    for (int i = 0; i < 3; ++i) wrist_target_[i] += target[TARGET_OFFSETS[position] + i];
    if (arm_.kind == ArmKind::PARALLEL)
      solve_parallel();
    else
      solve_wrist_position();
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(branch_count_),
                     [&](std::size_t a, std::size_t b) {
                       return branches_[a].distance < branches_[b].distance;
                     });
    return branch_count_;
  }

  const Triple& axis(int n) const { return arm_.joint_axes[n].axis; }
  const Triple& point_on(int n) const { return arm_.joint_axes[n].point; }

  // A point after a rotation about an axis.
  Triple rotate_point(int n, double angle, const Triple& point) const {
    return plus(point_on(n), rotate_about(axis(n), angle, minus(point, point_on(n))));
  }

  // Rotates a vector by the rotation of the goal, and by its inverse.
  Triple rotate_by_goal(const Triple& v) const {
    Triple out;
    rotate(goal_rotation_, v.data(), out.data());
    return out;
  }

  Triple unrotate_by_goal(const Triple& v) const {
    Triple out;
    for (int i = 0; i < 3; ++i)
      out[i] =
          goal_rotation_[i] * v[0] + goal_rotation_[3 + i] * v[1] + goal_rotation_[6 + i] * v[2];
    return out;
  }

  // The target of the wrist before the first rotation.
  Triple undo_first_rotation(double angle) const { return rotate_point(0, -angle, wrist_target_); }

  // Solves the first three angles by the method of the arm.
  void solve_wrist_position() {
    switch (arm_.method) {
      case WristMethod::PARALLEL_23:
        return solve_parallel_23();
      case WristMethod::INTERSECT_23:
        return solve_intersect_23();
      case WristMethod::INTERSECT_12:
        return solve_intersect_12();
      case WristMethod::PARALLEL_12:
        return solve_parallel_12();
      case WristMethod::NONE:
        return;
    }
  }

  // Axes 2 and 3 are parallel: the component along them determines the first angle.
  void solve_parallel_23() {
    const double component = dot_product(axis(1), minus(arm_.wrist, point_on(0)));
    const Triple reversed_axis = times(-1, axis(0));
    for_each_solution(angles_to_component(reversed_axis, minus(wrist_target_, point_on(0)), axis(1),
                                          component, RANGE_TOLERANCE, start_[0]),
                      [&](double first_angle) {
                        solve_in_plane(first_angle, undo_first_rotation(first_angle), arm_.wrist);
                      });
  }

  // The second and third angle, from the sides of a triangle.
  void solve_in_plane(double first_angle, const Triple& goal, const Triple& point) {
    const double distance = norm(minus(goal, point_on(1)));
    for_each_solution(
        angles_to_distance(axis(2), minus(point, point_on(2)), minus(point_on(1), point_on(2)),
                           distance, RANGE_TOLERANCE, start_[2]),
        [&](double third_angle) {
          const Triple rotated_point = rotate_point(2, third_angle, point);
          const double second_angle = angle_between(axis(1), minus(rotated_point, point_on(1)),
                                                    minus(goal, point_on(1)), start_[1]);
          solve_wrist(first_angle, second_angle, third_angle);
        });
  }

  // Axes 2 and 3 intersect.
  void solve_intersect_23() {
    const Triple& intersection = arm_.intersection;
    const Triple reversed_axis = times(-1, axis(0));
    const double distance = norm(minus(arm_.wrist, intersection));
    for_each_solution(
        angles_to_distance(reversed_axis, minus(wrist_target_, point_on(0)),
                           minus(intersection, point_on(0)), distance, RANGE_TOLERANCE, start_[0]),
        [&](double first_angle) {
          angles_to_common_vector(times(-1, axis(1)),
                                  minus(undo_first_rotation(first_angle), intersection), axis(2),
                                  minus(arm_.wrist, intersection), RANGE_TOLERANCE, start_[1],
                                  start_[2], [&](double second_angle, double third_angle) {
                                    solve_wrist(first_angle, second_angle, third_angle);
                                  });
        });
  }

  // Axes 1 and 2 intersect.
  void solve_intersect_12() {
    const Triple& intersection = arm_.intersection;
    const double distance = norm(minus(wrist_target_, intersection));
    for_each_solution(
        angles_to_distance(axis(2), minus(arm_.wrist, point_on(2)),
                           minus(intersection, point_on(2)), distance, RANGE_TOLERANCE, start_[2]),
        [&](double third_angle) {
          const Triple rotated_point = rotate_point(2, third_angle, arm_.wrist);
          angles_to_common_vector(times(-1, axis(0)), minus(wrist_target_, intersection), axis(1),
                                  minus(rotated_point, intersection), RANGE_TOLERANCE, start_[0],
                                  start_[1], [&](double first_angle, double second_angle) {
                                    solve_wrist(first_angle, second_angle, third_angle);
                                  });
        });
  }

  // Axes 1 and 2 are parallel.
  void solve_parallel_12() {
    const double component = dot_product(axis(0), minus(wrist_target_, point_on(2)));
    for_each_solution(angles_to_component(axis(2), minus(arm_.wrist, point_on(2)), axis(0),
                                          component, RANGE_TOLERANCE, start_[2]),
                      [&](double third_angle) {
                        const Triple rotated_point = rotate_point(2, third_angle, arm_.wrist);
                        const double distance = norm(minus(wrist_target_, point_on(0)));
                        for_each_solution(
                            angles_to_distance(axis(1), minus(rotated_point, point_on(1)),
                                               minus(point_on(0), point_on(1)), distance,
                                               RANGE_TOLERANCE, start_[1]),
                            [&](double second_angle) {
                              const Triple rotated_twice =
                                  rotate_point(1, second_angle, rotated_point);
                              const double first_angle =
                                  angle_between(axis(0), minus(rotated_twice, point_on(0)),
                                                minus(wrist_target_, point_on(0)), start_[0]);
                              solve_wrist(first_angle, second_angle, third_angle);
                            });
                      });
  }

  // The last three angles, from the remaining rotation.
  void solve_wrist(double first_angle, double second_angle, double third_angle) {
    const auto undo_first_three = [&](const Triple& v) {
      return rotate_about(
          axis(2), -third_angle,
          rotate_about(axis(1), -second_angle, rotate_about(axis(0), -first_angle, v)));
    };
    const Triple last_axis = undo_first_three(rotate_by_goal(axis(5)));
    for_each_solution(
        angles_to_component(axis(4), axis(5), axis(3), dot_product(axis(3), last_axis),
                            RANGE_TOLERANCE, start_[4]),
        [&](double fifth_angle) {
          const Triple rotated_axis = rotate_about(axis(4), fifth_angle, axis(5));
          const double fourth_angle = angle_between(axis(3), rotated_axis, last_axis, start_[3]);
          // The vector farthest from the last axis compensates the error of the fourth angle.
          const Triple perpendicular = orthogonal(axis(5));
          const Triple goal = undo_first_three(rotate_by_goal(perpendicular));
          const Triple remaining =
              rotate_about(axis(4), -fifth_angle, rotate_about(axis(3), -fourth_angle, goal));
          add_branch({first_angle, second_angle, third_angle, fourth_angle, fifth_angle,
                      angle_between(axis(5), perpendicular, remaining, start_[5])});
        });
  }

  // A vector orthogonal to another.
  static Triple orthogonal(const Triple& v) {
    int smallest = std::fabs(v[1]) < std::fabs(v[0]) ? 1 : 0;
    if (std::fabs(v[2]) < std::fabs(v[smallest])) smallest = 2;
    Triple unit{};
    unit[smallest] = 1;
    return cross_product(v, unit);
  }

  // Axes 2 to 4 are parallel: the first angle follows from the component of the wrist along them,
  // the fifth from that of the last axis.
  void solve_parallel() {
    const Triple& normal = axis(1);
    const Triple reversed_axis = times(-1, axis(0));
    const double component = dot_product(normal, minus(arm_.wrist, point_on(0)));
    const Triple last_axis = rotate_by_goal(axis(5));
    for_each_solution(
        angles_to_component(reversed_axis, minus(wrist_target_, point_on(0)), normal, component,
                            RANGE_TOLERANCE, start_[0]),
        [&](double first_angle) {
          const Triple goal = undo_first_rotation(first_angle);
          const double axis_component =
              dot_product(normal, rotate_about(axis(0), -first_angle, last_axis));
          for_each_solution(
              angles_to_component(axis(4), axis(5), normal, axis_component, RANGE_TOLERANCE,
                                  start_[4]),
              [&](double fifth_angle) { solve_parallel(first_angle, fifth_angle, goal); });
        });
  }

  void solve_parallel(double first_angle, double fifth_angle, const Triple& goal) {
    const Triple& normal = axis(1);
    const Triple normal_before = unrotate_by_goal(rotate_about(axis(0), first_angle, normal));
    const double sixth_angle = angle_between(
        axis(5), normal_before, rotate_about(axis(4), -fifth_angle, normal), start_[5]);
    // The sum of the three parallel rotations.
    const Triple perpendicular = orthogonal(normal);
    const Triple unrotated =
        rotate_about(axis(5), -sixth_angle, rotate_about(axis(4), -fifth_angle, perpendicular));
    const Triple rotated_side = rotate_about(axis(0), -first_angle, rotate_by_goal(unrotated));
    const double parallel_angle_sum = angle_between(normal, perpendicular, rotated_side, 0);
    const Triple wrist_start =
        minus(goal, rotate_about(normal, parallel_angle_sum, minus(arm_.wrist, point_on(3))));
    const double distance = norm(minus(wrist_start, point_on(1)));
    for_each_solution(
        angles_to_distance(axis(2), minus(point_on(3), point_on(2)),
                           minus(point_on(1), point_on(2)), distance, RANGE_TOLERANCE, start_[2]),
        [&](double third_angle) {
          const Triple rotated_point = rotate_point(2, third_angle, point_on(3));
          const double second_angle = angle_between(normal, minus(rotated_point, point_on(1)),
                                                    minus(wrist_start, point_on(1)), start_[1]);
          add_branch({first_angle, second_angle, third_angle,
                      parallel_angle_sum - second_angle - third_angle, fifth_angle, sixth_angle});
        });
  }

  template <class Function>
  static void for_each_solution(const AngleSolutions& angles, Function&& function) {
    for (int i = 0; i < angles.count; ++i) function(angles.values[i]);
  }

  // Stores a pose; each angle is shifted by full revolutions to the value nearest to the start
  // within its limits.
  void add_branch(const std::array<double, ARM_PINS>& angles) {
    if (branch_count_ == branches_.size()) return;
    Branch& pose = branches_[branch_count_];
    pose.distance = 0;
    for (std::size_t n = 0; n < ARM_PINS; ++n) {
      const double* limit = task_.chain.nodes[n].limit;
      double angle = angles[n] + REVOLUTION * std::nearbyint((start_[n] - angles[n]) / REVOLUTION);
      if (angle < limit[0] - RANGE_TOLERANCE)
        angle += REVOLUTION * std::ceil((limit[0] - RANGE_TOLERANCE - angle) / REVOLUTION);
      if (angle > limit[1] + RANGE_TOLERANCE)
        angle -= REVOLUTION * std::ceil((angle - limit[1] - RANGE_TOLERANCE) / REVOLUTION);
      if (!(angle >= limit[0] - RANGE_TOLERANCE)) return;
      pose.angles[n] = std::clamp(angle, limit[0], limit[1]);
      pose.distance += (angle - start_[n]) * (angle - start_[n]);
    }
    ++branch_count_;
  }

  double max_error() const {
    const double* errors = state_.errors.data();
    return *std::max_element(errors, errors + COMPONENT_COUNT);
  }

  // Sets state_ to a pose.
  void set_pose(const double* q, const double* target) {
    std::copy(q, q + ARM_PINS, state_.q.begin());
    compute_frames(task_.chain, state_.q.data(), state_.frames);
    measure(task_, target, state_);
  }

  // Sets state_ to the pose at which Newton's method ends; returns whether it reaches the target
  // within the limits.
  bool refine(const double* angles, const double* target) {
    double best_angles[ARM_PINS], next_angles[ARM_PINS], step[ARM_PINS];
    std::copy(angles, angles + ARM_PINS, best_angles);
    set_pose(best_angles, target);
    double error = max_error();
    for (int i = 0; i < ARM_NEWTON_STEPS && error > ARM_NEWTON_TOLERANCE; ++i) {
      solve_newton_step(target, step);
      for (std::size_t n = 0; n < ARM_PINS; ++n) {
        const double* limit = task_.chain.nodes[n].limit;
        next_angles[n] = std::clamp(best_angles[n] + step[n], limit[0], limit[1]);
      }
      set_pose(next_angles, target);
      const double next_error = max_error();
      if (!(next_error < error)) break;
      const bool is_converging_slowly = next_error > error / 2;
      error = next_error;
      std::copy(next_angles, next_angles + ARM_PINS, best_angles);
      if (is_converging_slowly) break;
    }
    set_pose(best_angles, target);
    const double* errors = state_.errors.data();
    for (int component = 0; component < COMPONENT_COUNT; ++component)
      if (!(errors[component] <= tolerances_[IS_LENGTH[component] ? 0 : 1])) return false;
    return true;
  }

  // Solves J d = r with full pivoting; unknowns without a pivot stay 0.
  void solve_newton_step(const double* target, double* step) {
    differentiate(task_, target, state_, linear_.columns);
    double rows[ARM_PINS][ARM_PINS + 1];
    std::size_t columns[ARM_PINS];
    for (std::size_t r = 0; r < ARM_PINS; ++r) {
      for (std::size_t c = 0; c < ARM_PINS; ++c) rows[r][c] = linear_.columns[c * ARM_PINS + r];
      rows[r][ARM_PINS] = state_.residuals[r];
      columns[r] = r;
    }
    std::size_t rank = 0;
    double first_pivot = 0;
    for (; rank < ARM_PINS; ++rank) {
      std::size_t row = rank, column = rank;
      for (std::size_t r = rank; r < ARM_PINS; ++r)
        for (std::size_t c = rank; c < ARM_PINS; ++c)
          if (std::fabs(rows[r][c]) > std::fabs(rows[row][column])) row = r, column = c;
      std::swap_ranges(rows[rank], rows[rank] + ARM_PINS + 1, rows[row]);
      if (column != rank) {
        for (auto& row_values : rows) std::swap(row_values[rank], row_values[column]);
        std::swap(columns[rank], columns[column]);
      }
      const double pivot = rows[rank][rank];
      if (rank == 0) first_pivot = std::fabs(pivot);
      if (!(std::fabs(pivot) > ARM_MIN_PIVOT * first_pivot)) break;
      for (std::size_t r = rank + 1; r < ARM_PINS; ++r) {
        const double ratio = rows[r][rank] / pivot;
        for (std::size_t c = rank; c <= ARM_PINS; ++c) rows[r][c] -= ratio * rows[rank][c];
      }
    }
    std::fill(step, step + ARM_PINS, 0.0);
    for (std::size_t r = rank; r-- > 0;) {
      double sum = rows[r][ARM_PINS];
      for (std::size_t c = r + 1; c < rank; ++c) sum -= rows[r][c] * step[columns[c]];
      step[columns[r]] = sum / rows[r][r];
    }
  }

  // The distance by which a target may be out of range because of rounding and nearly parallel
  // axes, as a fraction of the length.
  static constexpr double RANGE_TOLERANCE = 1e-9;

  const Task& task_;
  const ArmGeometry arm_;
  const double tolerances_[2];
  State state_;
  Linearized linear_;
  double goal_rotation_[9];  // rotation of the last node relative to the pose with zero angles
  Triple wrist_target_;      // target of the wrist
  const double* start_ = nullptr;
  std::array<Branch, MAX_BRANCHES> branches_;
  std::array<std::size_t, MAX_BRANCHES> order_;
  std::size_t branch_count_ = 0;
};

}  // namespace

ArmKind arm_kind(const Task& task) { return analyze_arm(task).kind; }

std::unique_ptr<Arm> make_arm(const Task& task, double length_tolerance, double angle_tolerance) {
  const ArmGeometry arm = analyze_arm(task);
  if (arm.kind == ArmKind::NONE) return nullptr;
  return std::make_unique<SixPins>(task, arm, length_tolerance, angle_tolerance);
}

}  // namespace animtool::ik
