// The equations of joints.
#include "rigid/joints.h"

#include <algorithm>
#include <limits>

#include "rigid/drives.h"

namespace animtool::rigid {

namespace {

constexpr double ANY = std::numeric_limits<double>::infinity();

// The rotation vector of a rotation, the short way.
Vec vector_of(Turn q) {
  if (q.w < 0) q = {-q.x, -q.y, -q.z, -q.w};
  const Vec v{q.x, q.y, q.z};
  const double n = length(v);
  return n > 1e-12 ? v * (2 * std::atan2(n, q.w) / n) : v * 2;
}

class Writing {
 public:
  Writing(const Speed& a, const Speed& b, double h) : a_(a), b_(b), h_(h) {}

  Row& along(Vec line, Vec arm_a, Vec arm_b, double error, double given, int slot) {
    Row row;
    row.line = line, row.arm_a = cross(arm_a, line), row.arm_b = cross(arm_b, line);
    return add(row, error, given, slot);
  }
  Row& about(Vec axis, double error, double given, int slot) {
    Row row;
    row.arm_a = row.arm_b = axis;
    return add(row, error, given, slot);
  }

  static void limit(Row& row) {
    row.kind = Row::LIMIT;
    row.least = 0;
  }
  void drive(Row& row, const Joint& joint) const {
    row.kind = Row::DRIVE;
    row.most = joint.most < 0 ? ANY : joint.most * h_;
    row.least = -row.most;
  }

  Rows rows;

 private:
  // Axes without inertia, such as a rod's, have no equation.
  Row& add(Row row, double error, double given, int slot) {
    const double k = dot(row.line, row.line) * (a_.ease + b_.ease) +
                     dot(row.arm_a, a_.turned(row.arm_a)) + dot(row.arm_b, b_.turned(row.arm_b));
    row.error = error, row.given = given, row.slot = slot;
    row.mass = k > 0 ? 1 / k : 0;
    row.most = ANY, row.least = -ANY;
    return (k > 0 ? rows.of[rows.count++] : unmoved_) = row;
  }

  Row unmoved_;
  const Speed &a_, &b_;
  double h_;
};

}  // namespace

Rows rows_of(const Joint& joint, const Anchor& a, const Anchor& b, Vec arm_a, Vec arm_b,
             const Speed& on_a, const Speed& on_b, double h) {
  Writing to(on_a, on_b, h);
  const Vec x = rotate(a.turn, {1, 0, 0}), y = rotate(a.turn, {0, 1, 0});
  const Vec z = rotate(a.turn, {0, 0, 1}), off = b.at - a.at;
  const Turn between = conjugate(a.turn) * b.turn;
  const bool slides = joint.kind == Joined::PRISMATIC;
  const Vec axes[3] = {x, y, z};
  // On a slide the arm of the first body reaches to the anchor of the second.
  const Vec reach_a = slides ? arm_a + off : arm_a;
  const Vec going = a.velocity + cross(a.spin, slides ? off : Vec{});
  for (int i = slides ? 1 : 0; i < 3; ++i)
    to.along(axes[i], reach_a, arm_b, dot(axes[i], off), -dot(axes[i], going), SLOT_LINE + i);
  if (joint.kind == Joined::FIXED || slides) {
    const Vec error = rotate(a.turn, vector_of(between));
    for (int i = 0; i < 3; ++i)
      to.about(axes[i], dot(axes[i], error), -dot(axes[i], a.spin), SLOT_TURN + i);
  } else if (joint.kind == Joined::PIN) {
    const Vec error = cross(x, rotate(b.turn, {1, 0, 0}));
    for (int i = 1; i < 3; ++i)
      to.about(axes[i], dot(axes[i], error), -dot(axes[i], a.spin), SLOT_TURN + i);
  }
  const bool limited = joint.low <= joint.high;
  if (slides) {
    const double slide = dot(x, off), given = -dot(x, going);
    if (limited) {
      to.limit(to.along(x, reach_a, arm_b, slide - joint.low, given, SLOT_LOW));
      to.limit(to.along(-x, reach_a, arm_b, joint.high - slide, -given, SLOT_HIGH));
    }
    if (driven(joint))
      to.drive(to.along(x, reach_a, arm_b, slide - joint.target, given, SLOT_DRIVE), joint);
    return to.rows;
  }
  if (joint.kind == Joined::FIXED) return to.rows;
  double twist = 2 * std::atan2(between.w < 0 ? -between.x : between.x, std::fabs(between.w));
  const bool ball = joint.kind == Joined::BALL;
  if (!ball) {
    // Of angles that differ by full rotations, the nearest to the allowed or target ones.
    const double about = limited ? (joint.low + joint.high) / 2 : joint.target;
    twist -= TURN * std::round((twist - about) / TURN);
  }
  const Vec far = rotate(b.turn, {1, 0, 0});
  const double lean = 1 + dot(x, far);
  // Rate of the twist of a ball, if it is not bent back.
  const Vec axis = ball && lean > 1e-6 ? (x + far) * (1 / lean) : x;
  if (limited) {
    const double given = -dot(axis, a.spin);
    to.limit(to.about(axis, twist - joint.low, given, SLOT_LOW));
    to.limit(to.about(-axis, joint.high - twist, -given, SLOT_HIGH));
  }
  if (ball && joint.swing[0] >= 0) {
    const Vec bend = cross(x, far);
    const double sine = length(bend), angle = std::atan2(sine, lean - 1);
    if (sine > 1e-9) {
      const Vec about = bend * (1 / sine), local = unrotate(a.turn, about);
      const double u = local.y * joint.swing[1], v = local.z * joint.swing[0];
      const double size = std::sqrt(u * u + v * v);
      const double most = size > 0 ? joint.swing[0] * joint.swing[1] / size : 0;
      to.limit(to.about(-about, most - angle, dot(about, a.spin), SLOT_SWING));
    }
  }
  if (!driven(joint)) return to.rows;
  if (!ball) {
    to.drive(to.about(x, twist - joint.target, -dot(x, a.spin), SLOT_DRIVE), joint);
    return to.rows;
  }
  const Vec error = rotate(a.turn, vector_of(between * conjugate(joint.goal)));
  for (int i = 0; i < 3; ++i)
    to.drive(to.about(axes[i], dot(axes[i], error), -dot(axes[i], a.spin), SLOT_DRIVE + i), joint);
  return to.rows;
}

double stretch_of(const Joint& joint, const Anchor& a, const Anchor& b) {
  Vec off = b.at - a.at;
  if (joint.kind == Joined::PRISMATIC) {
    const Vec x = rotate(a.turn, {1, 0, 0});
    off = off - x * dot(x, off);
  }
  return length(off);
}

}  // namespace animtool::rigid
