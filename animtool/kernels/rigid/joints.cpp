// The equations of joints.
#include "rigid/joints.h"

#include <algorithm>
#include <limits>

#include "rigid/drives.h"

namespace animtool::rigid {

namespace {

constexpr double UNLIMITED = std::numeric_limits<double>::infinity();

// The rotation vector of a rotation, the short way.
Vec vector_of(Quaternion q) {
  if (q.w < 0) q = {-q.x, -q.y, -q.z, -q.w};
  const Vec v{q.x, q.y, q.z};
  const double n = length(v);
  return n > 1e-12 ? v * (2 * std::atan2(n, q.w) / n) : v * 2;
}

class RowWriter {
 public:
  RowWriter(const Speed& a, const Speed& b, double h) : a_(a), b_(b), h_(h) {}

  Row& along(Vec line, Vec arm_a, Vec arm_b, double error, double bias_speed, int slot) {
    Row row;
    row.line = line, row.arm_a = cross(arm_a, line), row.arm_b = cross(arm_b, line);
    return add(row, error, bias_speed, slot);
  }
  Row& about(Vec axis, double error, double bias_speed, int slot) {
    Row row;
    row.arm_a = row.arm_b = axis;
    return add(row, error, bias_speed, slot);
  }

  static void limit(Row& row) {
    row.kind = Row::LIMIT;
    row.low = 0;
  }
  void drive(Row& row, const Joint& joint) const {
    row.kind = Row::DRIVE;
    row.high = joint.max_force < 0 ? UNLIMITED : joint.max_force * h_;
    row.low = -row.high;
  }

  Rows rows;

 private:
  // Axes without inertia, such as a rod's, have no equation.
  Row& add(Row row, double error, double bias_speed, int slot) {
    const double k = dot(row.line, row.line) * (a_.inverse_mass + b_.inverse_mass) +
                     dot(row.arm_a, a_.angular_response(row.arm_a)) +
                     dot(row.arm_b, b_.angular_response(row.arm_b));
    row.error = error, row.bias_speed = bias_speed, row.slot = slot;
    row.mass = k > 0 ? 1 / k : 0;
    row.high = UNLIMITED, row.low = -UNLIMITED;
    return (k > 0 ? rows.of[rows.count++] : unmoved_) = row;
  }

  Row unmoved_;
  const Speed &a_, &b_;
  double h_;
};

}  // namespace

Rows rows_of(const Joint& joint, const Anchor& a, const Anchor& b, Vec arm_a, Vec arm_b,
             const Speed& on_a, const Speed& on_b, double h) {
  RowWriter to(on_a, on_b, h);
  const Vec x = rotate(a.rotation, {1, 0, 0}), y = rotate(a.rotation, {0, 1, 0});
  const Vec z = rotate(a.rotation, {0, 0, 1}), off = b.at - a.at;
  const Quaternion between = conjugate(a.rotation) * b.rotation;
  const bool slides = joint.kind == JointKind::PRISMATIC;
  const Vec axes[3] = {x, y, z};
  // On a slide the arm of the first body reaches to the anchor of the second.
  const Vec reach_a = slides ? arm_a + off : arm_a;
  const Vec anchor_velocity = a.velocity + cross(a.spin, slides ? off : Vec{});
  for (int i = slides ? 1 : 0; i < 3; ++i)
    to.along(axes[i], reach_a, arm_b, dot(axes[i], off), -dot(axes[i], anchor_velocity),
             SLOT_LINE + i);
  if (joint.kind == JointKind::FIXED || slides) {
    const Vec error = rotate(a.rotation, vector_of(between));
    for (int i = 0; i < 3; ++i)
      to.about(axes[i], dot(axes[i], error), -dot(axes[i], a.spin), SLOT_ROTATION + i);
  } else if (joint.kind == JointKind::PIN) {
    const Vec error = cross(x, rotate(b.rotation, {1, 0, 0}));
    for (int i = 1; i < 3; ++i)
      to.about(axes[i], dot(axes[i], error), -dot(axes[i], a.spin), SLOT_ROTATION + i);
  }
  const bool limited = joint.low <= joint.high;
  if (slides) {
    const double slide = dot(x, off), bias_speed = -dot(x, anchor_velocity);
    if (limited) {
      to.limit(to.along(x, reach_a, arm_b, slide - joint.low, bias_speed, SLOT_LOW));
      to.limit(to.along(-x, reach_a, arm_b, joint.high - slide, -bias_speed, SLOT_HIGH));
    }
    if (driven(joint))
      to.drive(to.along(x, reach_a, arm_b, slide - joint.target, bias_speed, SLOT_DRIVE), joint);
    return to.rows;
  }
  if (joint.kind == JointKind::FIXED) return to.rows;
  double twist = 2 * std::atan2(between.w < 0 ? -between.x : between.x, std::fabs(between.w));
  const bool ball = joint.kind == JointKind::BALL;
  if (!ball) {
    // Of angles that differ by full rotations, the nearest to the allowed or target ones.
    const double about = limited ? (joint.low + joint.high) / 2 : joint.target;
    twist -= FULL_CIRCLE * std::round((twist - about) / FULL_CIRCLE);
  }
  const Vec twisted_axis = rotate(b.rotation, {1, 0, 0});
  const double one_plus_cosine = 1 + dot(x, twisted_axis);
  // Rate of the twist of a ball, if it is not bent back.
  const Vec axis = ball && one_plus_cosine > 1e-6 ? (x + twisted_axis) * (1 / one_plus_cosine) : x;
  if (limited) {
    const double bias_speed = -dot(axis, a.spin);
    to.limit(to.about(axis, twist - joint.low, bias_speed, SLOT_LOW));
    to.limit(to.about(-axis, joint.high - twist, -bias_speed, SLOT_HIGH));
  }
  if (ball && joint.swing[0] >= 0) {
    const Vec bend = cross(x, twisted_axis);
    const double sine = length(bend), angle = std::atan2(sine, one_plus_cosine - 1);
    if (sine > 1e-9) {
      const Vec about = bend * (1 / sine), local = unrotate(a.rotation, about);
      const double u = local.y * joint.swing[1], v = local.z * joint.swing[0];
      const double size = std::sqrt(u * u + v * v);
      const double limit_angle = size > 0 ? joint.swing[0] * joint.swing[1] / size : 0;
      to.limit(to.about(-about, limit_angle - angle, dot(about, a.spin), SLOT_SWING));
    }
  }
  if (!driven(joint)) return to.rows;
  if (!ball) {
    to.drive(to.about(x, twist - joint.target, -dot(x, a.spin), SLOT_DRIVE), joint);
    return to.rows;
  }
  const Vec error = rotate(a.rotation, vector_of(between * conjugate(joint.goal)));
  for (int i = 0; i < 3; ++i)
    to.drive(to.about(axes[i], dot(axes[i], error), -dot(axes[i], a.spin), SLOT_DRIVE + i), joint);
  return to.rows;
}

double stretch_of(const Joint& joint, const Anchor& a, const Anchor& b) {
  Vec off = b.at - a.at;
  if (joint.kind == JointKind::PRISMATIC) {
    const Vec x = rotate(a.rotation, {1, 0, 0});
    off = off - x * dot(x, off);
  }
  return length(off);
}

}  // namespace animtool::rigid
