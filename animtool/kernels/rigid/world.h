// The world of a rigid body step: constants, state, and contacts.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "colliders/colliders.h"
#include "rigid/cores.h"
#include "rigid/joints.h"
#include "rigid/spin.h"

namespace animtool::rigid {

struct Material {
  double restitution = 0, friction = 0;
};

struct Body {
  double inverse_mass = 0;           // 1 / mass
  InverseInertia inverse_inertia{};  // 1 / moments of inertia, of principal axes
  double reach = 0;
};

struct Shape {
  std::size_t body = 0;
  Core core;
  Material material;
};

struct World {
  std::vector<Body> bodies;
  std::vector<Shape> shapes;  // body by body
  std::vector<Joint> joints;
  // Excluded pairs of bodies, or of a body and a collider (numbered after bodies); ascending.
  std::vector<std::uint64_t> excluded;
};

struct Settings {
  Method method = Method::SPLITTING;
  int substeps = 8;
  int iterations = 64;        // largest number of iterations of a substep
  double tolerance = 1e-3;    // velocity change at convergence [m/s]
  double sleep_speed = 0.02;  // speed below which bodies fall asleep [m/s]; 0 is never
  double sleep_time = 0.5;    // time at that speed before sleep [s]
};

// A body in the world, with spin and momentum in the world.
struct State {
  Vec at, velocity, momentum;
  Quaternion rotation;
  double slow_time = 0;  // time it has been slow [s]; asleep from `rest` on
};

// A contact point kept between steps: its position on the first body, and normal and tangential
// impulses.
struct StoredContact {
  std::int64_t first, second;  // shapes; colliders are numbered after them
  Vec at, force;
};

struct Report {
  double deepest = 0;                    // [m]
  std::int64_t first = -1, second = -1;  // its shapes; colliders are numbered after them
  double residual = 0;                   // largest velocity change of the last iteration [m/s]
  std::int64_t contacts = 0, iterations = 0, awake = 0, unsolved = 0;
  double drive_step = 0;    // step that would resolve the fastest oscillating drive [s], if any
  std::int64_t drive = -1;  // its joint

  void record_drive(double step, std::size_t joint) {
    if (drive < 0 || step < drive_step) drive_step = step, drive = static_cast<std::int64_t>(joint);
  }

  // Merges the result of a later substep.
  void add(const Report& later) {
    if (later.deepest > deepest)
      deepest = later.deepest, first = later.first, second = later.second;
    if (later.drive >= 0) record_drive(later.drive_step, static_cast<std::size_t>(later.drive));
    residual = std::max(residual, later.residual);
    contacts = later.contacts, awake = later.awake;
    iterations += later.iterations, unsolved += later.unsolved;
  }
};

// A pair that may touch, and its contact: the second may be a collider.
struct Contact {
  std::size_t first = 0;    // shape
  std::int64_t second = 0;  // shape, or collider after the shapes
  std::size_t a = 0;        // body
  std::ptrdiff_t b = -1;    // body; -1 for a collider
  Material material;
  double depenetration = 0;  // largest push-out speed of a collider [m/s]; 0 is unlimited
  const collide::Motion* motion = nullptr;  // of a collider
  Vec normal;                               // from the first to the second
  int count = 0;
  // Contact points in the frames of both bodies, and the gaps. Rolling shapes change their contact
  // point continuously: these are points of the first's core, and its surface is a radius away.
  std::array<Vec, MAX_POINTS> on_a, on_b;
  std::array<double, MAX_POINTS> gaps;
  double radius = 0, other_radius = 0;

  void take(const Manifold& manifold, const Pose& pose_a, const Pose& pose_b) {
    normal = manifold.normal, count = manifold.count;
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
      const Vec at = manifold.points[k].at;
      on_a[k] = pose_a.to_local(at - normal * radius);
      on_b[k] = pose_b.to_local(at + normal * other_radius);
      gaps[k] = manifold.points[k].gap;
    }
  }
};

inline Pose pose_of(const State& s) {
  Pose pose;
  pose.origin = s.at;
  const double q[4] = {s.rotation.x, s.rotation.y, s.rotation.z, s.rotation.w};
  ik::to_matrix(q, pose.rotation);
  return pose;
}

inline Vec spin_of(const Body& body, const State& s) {
  const Vec p = unrotate(s.rotation, s.momentum);
  return rotate(s.rotation, {p.x * body.inverse_inertia.of[0], p.y * body.inverse_inertia.of[1],
                             p.z * body.inverse_inertia.of[2]});
}

inline bool asleep(const State& s, const Settings& settings) {
  return settings.sleep_speed > 0 && s.slow_time >= settings.sleep_time;
}

// Pairs that may touch within a step, in an order independent of positions. Sleeping bodies are
// skipped unless something awake or moving touches them.
std::vector<Contact> find_contacts(const World& world, const std::vector<State>& states,
                                   const std::vector<collide::Collider>& colliders,
                                   const Settings& settings, double step);

// Takes a step; updates contacts and joint impulses.
Report step_world(const World& world, std::vector<State>& states,
                  std::vector<StoredContact>& stored,
                  std::vector<std::array<double, ROWS>>& joint_impulses,
                  const std::vector<Vec>& forces, const std::vector<Vec>& torques,
                  const std::vector<collide::Collider>& colliders,
                  const std::vector<collide::Motion>& anchors, const Settings& settings,
                  double step);

}  // namespace animtool::rigid
