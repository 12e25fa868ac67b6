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

// Coefficients of restitution and friction.
struct Material {
  double restitution = 0, friction = 0;
};

// Constants of a body.
struct Body {
  double inverse_mass = 0;           // 1 / mass
  InverseInertia inverse_inertia{};  // 1 / moments of inertia, of principal axes
  double bounding_radius = 0;        // distance of its farthest point from the centre
};

// A shape of a body.
struct Shape {
  std::size_t body = 0;
  Core core;
  Material material;
};

// Constants of a world.
struct World {
  std::vector<Body> bodies;
  std::vector<Shape> shapes;  // sorted by body
  std::vector<Joint> joints;
  // Excluded pairs of bodies, or of a body and a collider, numbered after the bodies; ascending.
  std::vector<std::uint64_t> excluded_pairs;
};

// Settings of a step.
struct Settings {
  Method method = Method::SPLITTING;
  int substeps = 8;
  int max_iterations = 64;    // largest number of iterations in a substep
  double tolerance = 1e-3;    // velocity change at convergence [m/s]
  double sleep_speed = 0.02;  // speed below which bodies fall asleep [m/s]; 0 disables sleep
  double sleep_time = 0.5;    // time below that speed before sleep [s]
};

// A body in the world, with its angular momentum in the world.
struct State {
  Vec position, velocity, momentum;
  Quaternion rotation;
  double slow_time = 0;  // time it has been slow [s]; it sleeps from `sleep_time` on
};

// A contact point that is stored between steps: its position on the first body, and its normal and
// tangential force.
struct StoredContact {
  std::int64_t first_shape, second_shape;  // colliders are numbered after the shapes
  Vec position, force;
};

// Result of a step.
struct Report {
  double max_depth = 0;  // largest penetration [m]
  std::int64_t first_shape = -1,
               second_shape =
                   -1;  // shapes of the deepest contact; colliders are numbered after the shapes
  double residual = 0;  // largest velocity change in the last iteration [m/s]
  std::int64_t
      contact_count = 0,
      iteration_count = 0, awake_count = 0,
      unsolved_count =
          0;  // of contacts, of iterations, of awake bodies, of substeps that did not converge
  double drive_step = 0;    // step that would resolve the fastest oscillating drive [s]
  std::int64_t drive = -1;  // joint of that drive, or -1

  void record_drive(double step, std::size_t joint) {
    if (drive < 0 || step < drive_step) drive_step = step, drive = static_cast<std::int64_t>(joint);
  }

  // Merges the report of a later substep.
  void add(const Report& later_report) {
    if (later_report.max_depth > max_depth)
      max_depth = later_report.max_depth, first_shape = later_report.first_shape,
      second_shape = later_report.second_shape;
    if (later_report.drive >= 0)
      record_drive(later_report.drive_step, static_cast<std::size_t>(later_report.drive));
    residual = std::max(residual, later_report.residual);
    contact_count = later_report.contact_count, awake_count = later_report.awake_count;
    iteration_count += later_report.iteration_count, unsolved_count += later_report.unsolved_count;
  }
};

// A pair of a body and another body or a collider that may touch, and its contact points.
struct Contact {
  std::size_t first_shape = 0;
  std::int64_t second_shape = 0;  // or collider, numbered after the shapes
  std::size_t body_a = 0;
  std::ptrdiff_t body_b = -1;  // -1 for a collider
  Material material;
  double depenetration = 0;  // largest push-out speed of a collider [m/s]; 0 if unlimited
  const collide::Motion* motion = nullptr;  // of a collider
  Vec normal;                               // from the first to the second body
  int count = 0;
  // Contact points in the frames of both bodies, and their gaps. The contact point of a rolling
  // shape changes continuously: these are points of the cores, whose surfaces are a radius away.
  std::array<Vec, MAX_MANIFOLD_POINTS> local_a, local_b;
  std::array<double, MAX_MANIFOLD_POINTS> gaps;
  double radius = 0, other_radius = 0;

  void set_manifold(const Manifold& manifold, const Pose& pose_a, const Pose& pose_b) {
    normal = manifold.normal, count = manifold.count;
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
      const Vec position = manifold.points[k].position;
      local_a[k] = pose_a.to_local(position - normal * radius);
      local_b[k] = pose_b.to_local(position + normal * other_radius);
      gaps[k] = manifold.points[k].gap;
    }
  }
};

// The pose of a state.
inline Pose pose_of(const State& s) {
  Pose pose;
  pose.origin = s.position;
  const double q[4] = {s.rotation.x, s.rotation.y, s.rotation.z, s.rotation.w};
  ik::to_matrix(q, pose.rotation);
  return pose;
}

// Angular velocity of a body in the world.
inline Vec angular_velocity_of(const Body& body, const State& s) {
  const Vec p = inverse_rotate(s.rotation, s.momentum);
  return rotate(s.rotation,
                {p.x * body.inverse_inertia.entries[0], p.y * body.inverse_inertia.entries[1],
                 p.z * body.inverse_inertia.entries[2]});
}

inline bool is_state_asleep(const State& s, const Settings& settings) {
  return settings.sleep_speed > 0 && s.slow_time >= settings.sleep_time;
}

// Finds the pairs that may touch within a step, in an order that does not depend on positions.
// Sleeping bodies are skipped unless something awake or moving touches them.
std::vector<Contact> find_contacts(const World& world, const std::vector<State>& states,
                                   const std::vector<collide::Collider>& colliders,
                                   const Settings& settings, double step);

// Advances a world by a step; updates states, contacts and joint impulses.
Report step_world(const World& world, std::vector<State>& states,
                  std::vector<StoredContact>& stored,
                  std::vector<std::array<double, JOINT_SLOT_COUNT>>& joint_impulses,
                  const std::vector<Vec>& forces, const std::vector<Vec>& torques,
                  const std::vector<collide::Collider>& colliders,
                  const std::vector<collide::Motion>& anchors, const Settings& settings,
                  double step);

}  // namespace animtool::rigid
