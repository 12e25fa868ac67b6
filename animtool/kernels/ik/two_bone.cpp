// The limb of two bones: a ball, then a pin across both, or two balls.
//
// The elbow bends until the tip is as far from the root as the target. Then the shoulder rotates
// the tip to the target by the shortest arc, and about the line to the target until the elbow
// points to the pole.
//
// Limits of the method: without a pole, a target within 1e-12 of the root, or exactly opposite to
// the start's direction, leaves the plane of the limb undetermined; a pole on the line from root
// to target does not change the plane.
#include <algorithm>
#include <cmath>

#include "ik/closed.h"
#include "ik/limits.h"

namespace animtool::ik {

namespace {

// Lengths below this fraction of the limb's count as zero.
constexpr double NO_LENGTH = 1e-12;

void perpendicular(const double* v, double* out) {
  int least = std::fabs(v[1]) < std::fabs(v[0]) ? 1 : 0;
  if (std::fabs(v[2]) < std::fabs(v[least])) least = 2;
  double side[3] = {0, 0, 0};
  side[least] = 1;
  cross(v, side, out);
  const double size = length(out);
  if (!(size > 0))
    out[0] = 1, out[1] = out[2] = 0;
  else
    for (int i = 0; i < 3; ++i) out[i] /= size;
}

// Normalises a vector; returns false if it has no length.
bool unit(const double* v, double* out) {
  const double size = length(v);
  if (!(size > NO_LENGTH * NO_LENGTH)) return false;
  for (int i = 0; i < 3; ++i) out[i] = v[i] / size;
  return true;
}

void unit_or_across(const double* v, const double* other, double* out) {
  if (!unit(v, out)) perpendicular(other, out);
}

void about(const double* axis, double angle, double* q) {
  const double sine = std::sin(angle / 2);
  for (int i = 0; i < 3; ++i) q[i] = axis[i] * sine;
  q[3] = std::cos(angle / 2);
}

// The largest of the squared components is the pivot (S. W. Shepperd, Quaternion from rotation
// matrix, 1978).
void of_matrix(const double* m, double* q) {
  const double trace = m[0] + m[4] + m[8];
  int pivot = 0;
  for (int i = 1; i < 4; ++i)
    if ((i == 3 ? trace : m[4 * i]) > m[4 * pivot]) pivot = i;
  if (pivot == 3) {
    q[0] = m[7] - m[5], q[1] = m[2] - m[6], q[2] = m[3] - m[1], q[3] = 1 + trace;
  } else {
    const int i = pivot, j = (i + 1) % 3, k = (i + 2) % 3;
    q[i] = 1 + m[4 * i] - m[4 * j] - m[4 * k];
    q[j] = m[3 * i + j] + m[3 * j + i];
    q[k] = m[3 * i + k] + m[3 * k + i];
    q[3] = m[3 * k + j] - m[3 * j + k];
  }
  make_unit(q);
  if (q[3] < 0)
    for (int i = 0; i < 4; ++i) q[i] = -q[i];
}

// The angle between the directions of two bones, 0 if straight, by a half-angle formula that is
// accurate at both ends.
double bend(double a, double b, double distance) {
  const double reach = std::clamp(distance, std::fabs(a - b), a + b);
  const double shorter = (a + b - reach) * (a + b + reach);
  const double longer = (reach - (a - b)) * (reach + (a - b));
  return 2 * std::atan2(std::sqrt(std::max(shorter, 0.0)), std::sqrt(std::max(longer, 0.0)));
}

// The signed angle from a to b about a line; 0 if undetermined.
double angle_about(const double* line, const double* a, const double* b) {
  double axis[3] = {0, 0, 0}, u[3], v[3], turned[3];
  unit(line, axis);
  const double along_a = dot(a, axis), along_b = dot(b, axis);
  for (int i = 0; i < 3; ++i) u[i] = a[i] - along_a * axis[i], v[i] = b[i] - along_b * axis[i];
  if (std::min(length(u), length(v)) < 1e-9) return 0;
  cross(u, v, turned);
  return std::atan2(dot(axis, turned), dot(u, v));
}

double nearest_revolution(double angle, double to) {
  return angle + REVOLUTION * std::nearbyint((to - angle) / REVOLUTION);
}

class TwoBone : public ClosedForm {
 public:
  explicit TwoBone(const Task& task)
      : goal_(task.goals[0]), elbow_(task.chain.nodes[1]), offset_{}, upper_{} {
    const Node& shoulder = task.chain.nodes[0];
    std::copy(shoulder.offset, shoulder.offset + 3, base_);
    std::copy(elbow_.offset, elbow_.offset + 3, offset_);
    of_matrix(shoulder.rest, rest_);
    for (int k = 0; k < 4; ++k) back_[k] = k < 3 ? -rest_[k] : rest_[k];
  }

  bool follows() const override { return false; }

  bool solve(const double* start, const double* target, const double* reachable, double scale,
             double* q, double* errors) override {
    constexpr int position = part_of<Position>(), poled = part_of<Pole>();
    const double* pole_target = target + COLUMNS[poled];
    std::fill(errors, errors + PARTS, 0.0);
    std::copy(start, start + (elbow_.kind == Kind::BALL ? 8 : 5), q);
    // A pole without a position goal is left to another solver.
    const bool has_position = weight_of(goal_, target, position) > 0;
    const bool has_pole = weight_of(goal_, target, poled) > 0;
    if (!has_position) return !has_pole;
    double lower[3], towards[3], tip[3], pole[3], world[4], reached[3];
    for (int i = 0; i < 3; ++i) {
      upper_[i] = scale * offset_[i];
      lower[i] = scale * goal_.bone[i] + goal_.tool[i];
      towards[i] = reachable[COLUMNS[position] + i] - base_[i];
      pole[i] = pole_target[i] - base_[i];
    }
    const double opened = bend(length(upper_), length(lower), length(towards));
    const bool valid = open_elbow(q, lower, opened);
    find_tip(q, lower, tip);
    rotate_shoulder(q, tip, towards);
    if (has_pole) rotate_to_pole(q, towards, pole);
    product(rest_, q, world);
    rotate_vector(world, tip, reached);
    double away[3], elbow[3];
    for (int i = 0; i < 3; ++i) away[i] = target[COLUMNS[position] + i] - base_[i] - reached[i];
    errors[position] = length(away);
    if (has_pole) {
      rotate_vector(world, upper_, elbow);
      errors[poled] = std::fabs(angle_about(reached, elbow, pole));
    }
    return valid;
  }

 private:
  // Sets the elbow; returns whether its limits allow it.
  bool open_elbow(double* q, const double* lower, double opened) const {
    double across[3];
    for (int i = 0; i < 3; ++i)
      across[i] = upper_[0] * elbow_.rest[i] + upper_[1] * elbow_.rest[3 + i] +
                  upper_[2] * elbow_.rest[6 + i];
    if (elbow_.kind == Kind::PIN) {
      const double offset = std::atan2(lower[1], lower[0]) - std::atan2(across[1], across[0]);
      const double side = std::sin(q[4] + offset) < 0 ? -1 : 1;
      const double first = nearest_revolution(side * opened - offset, q[4]);
      const double other = nearest_revolution(-side * opened - offset, q[4]);
      const auto inside = [&](double angle) {
        return angle >= elbow_.limit[0] && angle <= elbow_.limit[1];
      };
      q[4] = inside(first) ? first : other;
      return inside(first) || inside(other);
    }
    double* values = q + 4;
    double direction[3], normal[3], axis[3], turned[4], composed[4];
    rotate_vector(values, lower, direction);
    cross(across, direction, normal);
    unit_or_across(normal, across, axis);
    about(axis, opened - std::atan2(dot(axis, normal), dot(across, direction)), turned);
    product(turned, values, composed);
    make_unit(composed);
    std::copy(composed, composed + 4, values);
    return true;
  }

  // The tip in the shoulder's frame.
  void find_tip(const double* q, const double* lower, double* tip) const {
    const double z[3] = {0, 0, 1};
    double motion[4], turned[3];
    if (elbow_.kind == Kind::PIN)
      about(z, q[4], motion);
    else
      std::copy(q + 4, q + 8, motion);
    rotate_vector(motion, lower, turned);
    for (int i = 0; i < 3; ++i) tip[i] = upper_[i] + dot(turned, elbow_.rest + 3 * i);
  }

  void set_world(double* q, const double* world) const {
    product(back_, world, q);
    make_unit(q);
  }

  // Rotates the tip to its target by the shortest arc.
  void rotate_shoulder(double* q, const double* tip, const double* towards) const {
    double world[4];
    product(rest_, q, world);
    // Twice, because of the rounding error of the first rotation near half a turn.
    for (int i = 0; i < 2; ++i) {
      double now[3], normal[3], axis[3], turned[4], composed[4];
      rotate_vector(world, tip, now);
      cross(now, towards, normal);
      unit_or_across(normal, now, axis);
      about(axis, std::atan2(length(normal), dot(now, towards)), turned);
      product(turned, world, composed);
      make_unit(composed);
      std::copy(composed, composed + 4, world);
    }
    set_world(q, world);
  }

  void rotate_to_pole(double* q, const double* towards, const double* pole) const {
    double world[4], elbow[3], axis[3], turned[4], composed[4];
    product(rest_, q, world);
    rotate_vector(world, upper_, elbow);
    unit_or_across(towards, towards, axis);
    about(axis, angle_about(towards, elbow, pole), turned);
    product(turned, world, composed);
    set_world(q, composed);
  }

  const Goal goal_;
  const Node elbow_;
  double base_[3], offset_[3], upper_[3], rest_[4], back_[4];
};

}  // namespace

std::unique_ptr<ClosedForm> make_limb(const Task& task) { return std::make_unique<TwoBone>(task); }

}  // namespace animtool::ik
