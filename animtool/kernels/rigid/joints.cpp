// The equations of joints.
#include "rigid/joints.h"

#include <algorithm>
#include <limits>

#include "rigid/drives.h"

namespace animtool::rigid {

namespace {

constexpr double INF = std::numeric_limits<double>::infinity();

// The shortest rotation vector of a quaternion.
Vec rotation_vector(Quaternion q) {
  if (q.w < 0) q = {-q.x, -q.y, -q.z, -q.w};
  const Vec v{q.x, q.y, q.z};
  const double n = length(v);
  return n > 1e-12 ? v * (2 * std::atan2(n, q.w) / n) : v * 2;
}

// Builds the rows of a joint.
class RowBuilder {
 public:
  RowBuilder(const Speed& a, const Speed& b, double h) : a_(a), b_(b), h_(h) {}

  Row& add_linear(Vec line, Vec arm_a, Vec arm_b, double error, double bias_speed, int slot) {
    Row row;
    row.line = line, row.arm_a = cross(arm_a, line), row.arm_b = cross(arm_b, line);
    return add(row, error, bias_speed, slot);
  }
  Row& add_angular(Vec axis, double error, double bias_speed, int slot) {
    Row row;
    row.arm_a = row.arm_b = axis;
    return add(row, error, bias_speed, slot);
  }

  // Makes a row a limit, or a drive.
  static void set_limit(Row& row) {
    row.kind = Row::LIMIT;
    row.min_impulse = 0;
  }
  void set_drive(Row& row, const Joint& joint) const {
    row.kind = Row::DRIVE;
    row.max_impulse = joint.max_force < 0 ? INF : joint.max_force * h_;
    row.min_impulse = -row.max_impulse;
  }

  Rows rows;

 private:
  // Adds a row; axes without inertia, such as that of a rod, get none.
  Row& add(Row row, double error, double bias_speed, int slot) {
    const double inverse_mass = dot(row.line, row.line) * (a_.inverse_mass + b_.inverse_mass) +
                                dot(row.arm_a, a_.angular_response(row.arm_a)) +
                                dot(row.arm_b, b_.angular_response(row.arm_b));
    row.error = error, row.bias_speed = bias_speed, row.slot = slot;
    row.mass = inverse_mass > 0 ? 1 / inverse_mass : 0;
    row.max_impulse = INF, row.min_impulse = -INF;
    return (inverse_mass > 0 ? rows.entries[rows.count++] : discarded_row_) = row;
  }

  Row discarded_row_;
  const Speed &a_, &b_;
  double h_;
};

}  // namespace

Rows build_rows(const Joint& joint, const Anchor& a, const Anchor& b, Vec arm_a, Vec arm_b,
                const Speed& speed_a, const Speed& speed_b, double h) {
  RowBuilder builder(speed_a, speed_b, h);
  const Vec x = rotate(a.rotation, {1, 0, 0}), y = rotate(a.rotation, {0, 1, 0});
  const Vec z = rotate(a.rotation, {0, 0, 1}), offset = b.position - a.position;
  const Quaternion relative_rotation = conjugate(a.rotation) * b.rotation;
  const bool is_slide = joint.kind == JointKind::PRISMATIC;
  const Vec axes[3] = {x, y, z};
  // On a slide, the arm of the first body goes to the anchor of the second.
  const Vec slide_arm = is_slide ? arm_a + offset : arm_a;
  const Vec anchor_velocity = a.velocity + cross(a.angular_velocity, is_slide ? offset : Vec{});
  for (int i = is_slide ? 1 : 0; i < 3; ++i)
    builder.add_linear(axes[i], slide_arm, arm_b, dot(axes[i], offset),
                       -dot(axes[i], anchor_velocity), SLOT_LINE + i);
  if (joint.kind == JointKind::FIXED || is_slide) {
    const Vec error = rotate(a.rotation, rotation_vector(relative_rotation));
    for (int i = 0; i < 3; ++i)
      builder.add_angular(axes[i], dot(axes[i], error), -dot(axes[i], a.angular_velocity),
                          SLOT_ROTATION + i);
  } else if (joint.kind == JointKind::PIN) {
    const Vec error = cross(x, rotate(b.rotation, {1, 0, 0}));
    for (int i = 1; i < 3; ++i)
      builder.add_angular(axes[i], dot(axes[i], error), -dot(axes[i], a.angular_velocity),
                          SLOT_ROTATION + i);
  }
  const bool has_limit = joint.low_limit <= joint.high_limit;
  if (is_slide) {
    const double slide_distance = dot(x, offset), bias_speed = -dot(x, anchor_velocity);
    if (has_limit) {
      builder.set_limit(builder.add_linear(x, slide_arm, arm_b, slide_distance - joint.low_limit,
                                           bias_speed, SLOT_LOW));
      builder.set_limit(builder.add_linear(-x, slide_arm, arm_b, joint.high_limit - slide_distance,
                                           -bias_speed, SLOT_HIGH));
    }
    if (has_drive(joint))
      builder.set_drive(builder.add_linear(x, slide_arm, arm_b, slide_distance - joint.target,
                                           bias_speed, SLOT_DRIVE),
                        joint);
    return builder.rows;
  }
  if (joint.kind == JointKind::FIXED) return builder.rows;
  double twist_angle =
      2 * std::atan2(relative_rotation.w < 0 ? -relative_rotation.x : relative_rotation.x,
                     std::fabs(relative_rotation.w));
  const bool is_ball = joint.kind == JointKind::BALL;
  if (!is_ball) {
    // Of angles that differ by full revolutions, takes the nearest to the limits or to the target.
    const double reference = has_limit ? (joint.low_limit + joint.high_limit) / 2 : joint.target;
    twist_angle -= FULL_CIRCLE * std::round((twist_angle - reference) / FULL_CIRCLE);
  }
  const Vec twisted_axis = rotate(b.rotation, {1, 0, 0});
  const double one_plus_cosine = 1 + dot(x, twisted_axis);
  // The rate of the twist of a ball, if it is not bent by half a revolution.
  const Vec axis =
      is_ball && one_plus_cosine > 1e-6 ? (x + twisted_axis) * (1 / one_plus_cosine) : x;
  if (has_limit) {
    const double bias_speed = -dot(axis, a.angular_velocity);
    builder.set_limit(
        builder.add_angular(axis, twist_angle - joint.low_limit, bias_speed, SLOT_LOW));
    builder.set_limit(
        builder.add_angular(-axis, joint.high_limit - twist_angle, -bias_speed, SLOT_HIGH));
  }
  if (is_ball && joint.swing[0] >= 0) {
    const Vec swing_axis = cross(x, twisted_axis);
    const double sine = length(swing_axis), angle = std::atan2(sine, one_plus_cosine - 1);
    if (sine > 1e-9) {
      const Vec swing_direction = swing_axis * (1 / sine),
                local_swing = inverse_rotate(a.rotation, swing_direction);
      const double u = local_swing.y * joint.swing[1], v = local_swing.z * joint.swing[0];
      const double norm = std::sqrt(u * u + v * v);
      const double limit_angle = norm > 0 ? joint.swing[0] * joint.swing[1] / norm : 0;
      builder.set_limit(builder.add_angular(-swing_direction, limit_angle - angle,
                                            dot(swing_direction, a.angular_velocity), SLOT_SWING));
    }
  }
  if (!has_drive(joint)) return builder.rows;
  if (!is_ball) {
    builder.set_drive(
        builder.add_angular(x, twist_angle - joint.target, -dot(x, a.angular_velocity), SLOT_DRIVE),
        joint);
    return builder.rows;
  }
  const Vec error =
      rotate(a.rotation, rotation_vector(relative_rotation * conjugate(joint.target_rotation)));
  for (int i = 0; i < 3; ++i)
    builder.set_drive(builder.add_angular(axes[i], dot(axes[i], error),
                                          -dot(axes[i], a.angular_velocity), SLOT_DRIVE + i),
                      joint);
  return builder.rows;
}

double joint_gap(const Joint& joint, const Anchor& a, const Anchor& b) {
  Vec offset = b.position - a.position;
  if (joint.kind == JointKind::PRISMATIC) {
    const Vec x = rotate(a.rotation, {1, 0, 0});
    offset = offset - x * dot(x, offset);
  }
  return length(offset);
}

}  // namespace animtool::rigid
