// Closed form of a limb of two bones: a ball followed by a pin across both bones, or two balls.
//
// The elbow bends until the distance of the tip from the root is that of the target. Then the
// shoulder rotates the tip to the target by the shortest arc, and about the line to the target
// until the elbow points to the pole.
//
// Limits of the method: without a pole, the plane of the limb is undetermined if a target is within
// 1e-12 of the root, or exactly opposite to the direction of the start; a pole on the line from
// root to target does not change the plane.
#include <algorithm>
#include <cmath>

#include "ik/closed.h"
#include "ik/limits.h"

namespace animtool::ik {

namespace {

// Lengths below this fraction of the limb's length count as zero.
constexpr double ZERO_LENGTH = 1e-12;

// A unit vector perpendicular to another; x for zero length.
void perpendicular(const double* v, double* out) {
  int smallest = std::fabs(v[1]) < std::fabs(v[0]) ? 1 : 0;
  if (std::fabs(v[2]) < std::fabs(v[smallest])) smallest = 2;
  double axis[3] = {0, 0, 0};
  axis[smallest] = 1;
  cross(v, axis, out);
  const double norm = length(out);
  if (!(norm > 0))
    out[0] = 1, out[1] = out[2] = 0;
  else
    for (int i = 0; i < 3; ++i) out[i] /= norm;
}

// Normalises a vector; returns false for zero length.
bool normalize_vector(const double* v, double* out) {
  const double norm = length(v);
  if (!(norm > ZERO_LENGTH * ZERO_LENGTH)) return false;
  for (int i = 0; i < 3; ++i) out[i] = v[i] / norm;
  return true;
}

// The unit vector along v; for zero length, one perpendicular to another vector.
void unit_or_perpendicular(const double* v, const double* fallback, double* out) {
  if (!normalize_vector(v, out)) perpendicular(fallback, out);
}

// The quaternion of a rotation about an axis.
void axis_angle_quaternion(const double* axis, double angle, double* q) {
  const double sine = std::sin(angle / 2);
  for (int i = 0; i < 3; ++i) q[i] = axis[i] * sine;
  q[3] = std::cos(angle / 2);
}

// The quaternion of a matrix. The largest of the squared components is the pivot (S. W. Shepperd,
// Quaternion from rotation matrix, 1978).
void quaternion_from_matrix(const double* m, double* q) {
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
double elbow_angle(double a, double b, double distance) {
  const double clamped_distance = std::clamp(distance, std::fabs(a - b), a + b);
  const double shortening = (a + b - clamped_distance) * (a + b + clamped_distance);
  const double lengthening = (clamped_distance - (a - b)) * (clamped_distance + (a - b));
  return 2 *
         std::atan2(std::sqrt(std::max(shortening, 0.0)), std::sqrt(std::max(lengthening, 0.0)));
}

// The signed angle from a to b about a line; 0 if undetermined.
double angle_about(const double* line, const double* a, const double* b) {
  double axis[3] = {0, 0, 0}, u[3], v[3], cross_product[3];
  normalize_vector(line, axis);
  const double along_a = dot(a, axis), along_b = dot(b, axis);
  for (int i = 0; i < 3; ++i) u[i] = a[i] - along_a * axis[i], v[i] = b[i] - along_b * axis[i];
  if (std::min(length(u), length(v)) < 1e-9) return 0;
  cross(u, v, cross_product);
  return std::atan2(dot(axis, cross_product), dot(u, v));
}

// The angle plus full revolutions that is nearest to another.
double nearest_revolution(double angle, double reference) {
  return angle + REVOLUTION * std::nearbyint((reference - angle) / REVOLUTION);
}

class TwoBone : public ClosedForm {
 public:
  explicit TwoBone(const Task& task)
      : goal_(task.goals[0]), elbow_(task.chain.nodes[1]), elbow_offset_{}, upper_bone_{} {
    const Node& shoulder = task.chain.nodes[0];
    std::copy(shoulder.offset, shoulder.offset + 3, root_);
    std::copy(elbow_.offset, elbow_.offset + 3, elbow_offset_);
    quaternion_from_matrix(shoulder.rest, shoulder_rest_);
    for (int k = 0; k < 4; ++k)
      inverse_shoulder_rest_[k] = k < 3 ? -shoulder_rest_[k] : shoulder_rest_[k];
  }

  bool depends_on_start() const override { return false; }

  bool solve(const double* start, const double* target, const double* reachable, double scale,
             double* q, double* errors) override {
    constexpr int position = component_of<Position>(), pole_kind = component_of<Pole>();
    const double* pole_target = target + TARGET_OFFSETS[pole_kind];
    std::fill(errors, errors + COMPONENT_COUNT, 0.0);
    std::copy(start, start + (elbow_.kind == Kind::BALL ? 8 : 5), q);
    // A pole without a position goal needs another solver.
    const bool has_position = weight_of(goal_, target, position) > 0;
    const bool has_pole = weight_of(goal_, target, pole_kind) > 0;
    if (!has_position) return !has_pole;
    double lower_bone[3], root_to_target[3], tip[3], pole[3], world[4], reached_tip[3];
    for (int i = 0; i < 3; ++i) {
      upper_bone_[i] = scale * elbow_offset_[i];
      lower_bone[i] = scale * goal_.stretching_offset[i] + goal_.fixed_offset[i];
      root_to_target[i] = reachable[TARGET_OFFSETS[position] + i] - root_[i];
      pole[i] = pole_target[i] - root_[i];
    }
    const double angle =
        elbow_angle(length(upper_bone_), length(lower_bone), length(root_to_target));
    const bool is_within_limits = bend_elbow(q, lower_bone, angle);
    find_tip(q, lower_bone, tip);
    rotate_shoulder(q, tip, root_to_target);
    if (has_pole) rotate_to_pole(q, root_to_target, pole);
    product(shoulder_rest_, q, world);
    rotate_vector(world, tip, reached_tip);
    double difference[3], elbow[3];
    for (int i = 0; i < 3; ++i)
      difference[i] = target[TARGET_OFFSETS[position] + i] - root_[i] - reached_tip[i];
    errors[position] = length(difference);
    if (has_pole) {
      rotate_vector(world, upper_bone_, elbow);
      errors[pole_kind] = std::fabs(angle_about(reached_tip, elbow, pole));
    }
    return is_within_limits;
  }

 private:
  // Bends the elbow to an angle; returns whether its limits allow it.
  bool bend_elbow(double* q, const double* lower_bone, double angle) const {
    double upper_in_elbow_frame[3];
    for (int i = 0; i < 3; ++i)
      upper_in_elbow_frame[i] = upper_bone_[0] * elbow_.rest[i] +
                                upper_bone_[1] * elbow_.rest[3 + i] +
                                upper_bone_[2] * elbow_.rest[6 + i];
    if (elbow_.kind == Kind::PIN) {
      const double offset = std::atan2(lower_bone[1], lower_bone[0]) -
                            std::atan2(upper_in_elbow_frame[1], upper_in_elbow_frame[0]);
      const double side = std::sin(q[4] + offset) < 0 ? -1 : 1;
      const double near_solution = nearest_revolution(side * angle - offset, q[4]);
      const double far_solution = nearest_revolution(-side * angle - offset, q[4]);
      const auto is_within_limits = [&](double candidate) {
        return candidate >= elbow_.limit[0] && candidate <= elbow_.limit[1];
      };
      q[4] = is_within_limits(near_solution) ? near_solution : far_solution;
      return is_within_limits(near_solution) || is_within_limits(far_solution);
    }
    double* values = q + 4;
    double direction[3], normal[3], axis[3], rotation[4], composed[4];
    rotate_vector(values, lower_bone, direction);
    cross(upper_in_elbow_frame, direction, normal);
    unit_or_perpendicular(normal, upper_in_elbow_frame, axis);
    axis_angle_quaternion(
        axis, angle - std::atan2(dot(axis, normal), dot(upper_in_elbow_frame, direction)),
        rotation);
    product(rotation, values, composed);
    make_unit(composed);
    std::copy(composed, composed + 4, values);
    return true;
  }

  // Computes the position of the tip in the shoulder's frame.
  void find_tip(const double* q, const double* lower_bone, double* tip) const {
    const double z[3] = {0, 0, 1};
    double motion[4], rotated_bone[3];
    if (elbow_.kind == Kind::PIN)
      axis_angle_quaternion(z, q[4], motion);
    else
      std::copy(q + 4, q + 8, motion);
    rotate_vector(motion, lower_bone, rotated_bone);
    for (int i = 0; i < 3; ++i) tip[i] = upper_bone_[i] + dot(rotated_bone, elbow_.rest + 3 * i);
  }

  void set_world_rotation(double* q, const double* world) const {
    product(inverse_shoulder_rest_, world, q);
    make_unit(q);
  }

  // Rotates the tip to its target by the shortest arc.
  void rotate_shoulder(double* q, const double* tip, const double* root_to_target) const {
    double world[4];
    product(shoulder_rest_, q, world);
    // Twice, because the first rotation has a large rounding error near half a revolution.
    for (int i = 0; i < 2; ++i) {
      double current_tip[3], normal[3], axis[3], rotation[4], composed[4];
      rotate_vector(world, tip, current_tip);
      cross(current_tip, root_to_target, normal);
      unit_or_perpendicular(normal, current_tip, axis);
      axis_angle_quaternion(axis, std::atan2(length(normal), dot(current_tip, root_to_target)),
                            rotation);
      product(rotation, world, composed);
      make_unit(composed);
      std::copy(composed, composed + 4, world);
    }
    set_world_rotation(q, world);
  }

  // Rotates the elbow about the line to the target until it points to the pole.
  void rotate_to_pole(double* q, const double* root_to_target, const double* pole) const {
    double world[4], elbow[3], axis[3], rotation[4], composed[4];
    product(shoulder_rest_, q, world);
    rotate_vector(world, upper_bone_, elbow);
    unit_or_perpendicular(root_to_target, root_to_target, axis);
    axis_angle_quaternion(axis, angle_about(root_to_target, elbow, pole), rotation);
    product(rotation, world, composed);
    set_world_rotation(q, composed);
  }

  const Goal goal_;
  const Node elbow_;
  double root_[3], elbow_offset_[3], upper_bone_[3], shoulder_rest_[4], inverse_shoulder_rest_[4];
};

}  // namespace

std::unique_ptr<ClosedForm> make_limb(const Task& task) { return std::make_unique<TwoBone>(task); }

}  // namespace animtool::ik
