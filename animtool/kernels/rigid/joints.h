// Joints between two bodies, or an animated frame and a body.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "rigid/cores.h"
#include "rigid/spin.h"

namespace animtool::rigid {

enum class JointKind : std::int64_t { FIXED, PIN, BALL, PRISMATIC };

// A frame on a body: x is the axis of a pin, the direction of a slide, and the twist axis of a
// ball.
struct Frame {
  Vec at;
  Quaternion rotation;
};

struct Joint {
  JointKind kind = JointKind::FIXED;
  std::ptrdiff_t a = -1;  // body; -1 for an animated frame
  std::size_t b = 0;      // body
  Frame on_a, on_b;
  double low = 1, high = 0;           // of angle, slide or twist; none if low is above high
  double swing[2] = {-1, -1};         // half-angles about y and z; none if negative
  double target = 0;                  // of the drive: angle or slide
  Quaternion goal;                    // target of a ball's drive: b relative to a
  double stiffness = 0, damping = 0;  // of the drive: N/m, N s/m, or per rad
  double speed = 0;                   // target speed of the drive's damping
  double max_force = -1;              // largest force or torque of the drive; unlimited if negative
};

// Velocities of a body during a step.
struct Speed {
  Vec v, w;
  double inverse_mass = 0;                                  // 1 / mass
  double inverse_inertia[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};  // inverse inertia, of the world

  Vec angular_response(Vec a) const {
    return {inverse_inertia[0] * a.x + inverse_inertia[1] * a.y + inverse_inertia[2] * a.z,
            inverse_inertia[3] * a.x + inverse_inertia[4] * a.y + inverse_inertia[5] * a.z,
            inverse_inertia[6] * a.x + inverse_inertia[7] * a.y + inverse_inertia[8] * a.z};
  }
};

// Compliance of a constraint: a damped spring, solved implicitly. Macklin et al. (2019), "Small
// steps in physics simulation", and Catto (2011), "Soft constraints".
struct Softness {
  double bias = 0, mass = 1, leak = 0;

  // A spring of a frequency [1/s] and a damping ratio.
  static Softness of(double frequency, double ratio, double h) {
    const double omega = 2 * 3.14159265358979323846 * frequency;
    const double a = 2 * ratio + h * omega, b = h * omega * a, c = 1 / (1 + b);
    return {omega / a, b * c, c};
  }
};

// One equation: along a line and about an axis of each body.
struct Row {
  Vec line;                    // 0 for rotation rows
  Vec arm_a, arm_b;            // moment arms of both bodies
  double bias_speed = 0;       // speed added by the animation
  double error = 0;            // constraint error: should be 0, or not below it
  double curvature_speed = 0;  // additional error in a substep from curvature, over its time
  double mass = 0, impulse = 0, half = 0;
  double low = 0, high = 0;   // of the impulse
  double give = 0, push = 0;  // of a drive: impulse by speed, and by position
  enum { LOCK, LIMIT, DRIVE } kind = LOCK;
  int slot = 0;
};

// Slots of a joint's rows in the impulses kept between steps.
enum {
  SLOT_LINE = 0,
  SLOT_ROTATION = 3,
  SLOT_LOW = 6,
  SLOT_HIGH = 7,
  SLOT_SWING = 8,
  SLOT_DRIVE = 9
};
constexpr std::size_t ROWS = 12;
constexpr double FULL_CIRCLE = 2 * 3.14159265358979323846;  // [rad]

// A frame in the world, and its animated motion.
struct Anchor {
  Vec at;
  Quaternion rotation;
  Vec velocity, spin;
};

struct Rows {
  std::array<Row, ROWS> of;
  std::size_t count = 0;
};

// The equations of a joint with its frames in the world, for a step. `arm_a` and `arm_b` are from
// the centres of both bodies.
Rows rows_of(const Joint& joint, const Anchor& a, const Anchor& b, Vec arm_a, Vec arm_b,
             const Speed& on_a, const Speed& on_b, double h);

// Distance between the anchors of a joint [m].
double stretch_of(const Joint& joint, const Anchor& a, const Anchor& b);

}  // namespace animtool::rigid
