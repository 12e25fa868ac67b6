// Joints between two bodies, or between an animated frame and a body.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "rigid/cores.h"
#include "rigid/spin.h"

namespace animtool::rigid {

enum class JointKind : std::int64_t { FIXED, PIN, BALL, PRISMATIC };

// A frame on a body; x is the axis of a pin, the direction of a slide, and the twist axis of a
// ball.
struct Frame {
  Vec position;
  Quaternion rotation;
};

// The constants of a joint between two bodies.
struct Joint {
  JointKind kind = JointKind::FIXED;
  std::ptrdiff_t a = -1;  // body; -1 for an animated frame
  std::size_t b = 0;      // body
  Frame frame_a, frame_b;
  double low_limit = 1,
         high_limit = 0;              // of the angle, slide or twist; no limit if low is above high
  double swing[2] = {-1, -1};         // half-angles about y and z; no limit if negative
  double target = 0;                  // of the drive: angle or slide
  Quaternion target_rotation;         // target of a ball's drive: rotation of b relative to a
  double stiffness = 0, damping = 0;  // of the drive: N/m and N s/m, or per rad
  double speed = 0;                   // target speed of the drive's damping
  double max_force = -1;              // largest force or torque of the drive; unlimited if negative
};

// Velocities of a body during a step, and its inverse mass and inertia.
struct Speed {
  Vec v, w;
  double inverse_mass = 0;                                  // 1 / mass
  double inverse_inertia[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};  // in the world

  // Change of angular velocity by an angular impulse.
  Vec angular_response(Vec a) const {
    return {inverse_inertia[0] * a.x + inverse_inertia[1] * a.y + inverse_inertia[2] * a.z,
            inverse_inertia[3] * a.x + inverse_inertia[4] * a.y + inverse_inertia[5] * a.z,
            inverse_inertia[6] * a.x + inverse_inertia[7] * a.y + inverse_inertia[8] * a.z};
  }
};

// Softness of a constraint: a damped spring, solved implicitly. Macklin et al. (2019), "Small steps
// in physics simulation", and Catto (2011), "Soft constraints".
struct Softness {
  double bias_rate = 0, mass_factor = 1, impulse_factor = 0;

  // A spring with a frequency [1/s] and a damping ratio, for a step h.
  static Softness from_frequency(double frequency, double damping_ratio, double h) {
    const double omega = 2 * 3.14159265358979323846 * frequency;
    const double a = 2 * damping_ratio + h * omega, b = h * omega * a, c = 1 / (1 + b);
    return {omega / a, b * c, c};
  }
};

// One equation of a joint: along a line, and about an axis of each body.
struct Row {
  Vec line;                    // 0 for rows of rotations
  Vec arm_a, arm_b;            // moment arms of both bodies
  double bias_speed = 0;       // relative speed of the animation
  double error = 0;            // constraint error: must be 0, or not below 0
  double curvature_speed = 0;  // additional error in a substep from curvature, over its time
  double mass = 0, impulse = 0, half_impulse = 0;
  double min_impulse = 0, max_impulse = 0;      // bounds of the impulse
  double speed_gain = 0, position_impulse = 0;  // of a drive: impulse by speed, and by position
  enum { LOCK, LIMIT, DRIVE } kind = LOCK;
  int slot = 0;
};

// Indices of a joint's rows in the impulses that are stored between steps.
enum {
  SLOT_LINE = 0,
  SLOT_ROTATION = 3,
  SLOT_LOW = 6,
  SLOT_HIGH = 7,
  SLOT_SWING = 8,
  SLOT_DRIVE = 9
};
constexpr std::size_t JOINT_SLOT_COUNT = 12;
constexpr double FULL_CIRCLE = 2 * 3.14159265358979323846;  // [rad]

// A frame in the world, and the velocity of its animation.
struct Anchor {
  Vec position;
  Quaternion rotation;
  Vec velocity, angular_velocity;
};

// The equations of a joint.
struct Rows {
  std::array<Row, JOINT_SLOT_COUNT> entries;
  std::size_t count = 0;
};

// Builds the equations of a joint for a step, given its frames in the world. `arm_a` and `arm_b`
// are from the centres of both bodies to these.
Rows build_rows(const Joint& joint, const Anchor& a, const Anchor& b, Vec arm_a, Vec arm_b,
                const Speed& speed_a, const Speed& speed_b, double h);

// Distance between the anchors of a joint [m].
double joint_gap(const Joint& joint, const Anchor& a, const Anchor& b);

}  // namespace animtool::rigid
