// Collisions of particles with fixed and moving shapes: when they touch within a step, and how
// they respond. Works on plain numbers, so that any loop over particles can call it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "colliders/arrays.h"
#include "colliders/mesh.h"

namespace animtool::collide {

enum class Shape : std::int64_t { PLANE, SPHERE, CAPSULE, BOX, MESH };

// A shape, its motion over a step, and how particles bounce off it.
struct Collider {
  Shape shape = Shape::PLANE;
  // Plane: normal, offset. Sphere: centre, radius. Capsule: both ends, radius. Box: half
  // extents. In the frame of the collider [m].
  double size[7] = {0, 1, 0, 0, 0, 0, 0};
  Mesh mesh = {};
  std::int32_t mesh_root = 0;  // root node of the bounding boxes of the mesh
  Motion motion;
  // Particles are kept inside instead of outside.
  bool is_container = false;
  // A mesh that is hit from both sides.
  bool is_two_sided = false;
  // Coefficients of restitution and of Coulomb friction [1]; margin [m]; speed at which a particle
  // that starts inside is moved out [m/s].
  double restitution = 0, friction = 0, margin = 0, depenetration = 1;
};

// The last contact event of a particle in a step.
enum class Touch : std::int64_t { NONE, BOUNCED, RESTING, UNRESOLVED };

struct Contact {
  std::int64_t collider = -1;
  Touch touch = Touch::NONE;
  Vec normal;
};

struct Particle {
  Vec position, velocity;
};

// Largest number of contacts of one particle in one step.
constexpr int MAX_CONTACTS_PER_STEP = 8;
// Advancements along a path, after which it is stepped through in fixed fractions.
constexpr int MAX_ADVANCES = 64;
// Bisections to find the time at which a path crosses a surface.
constexpr int CROSSING_BISECTIONS = 24;
// Largest number of colliders that can be marked as impossible to hit.
constexpr std::size_t MAX_CULLED_COLLIDERS = 64;
// Passes over all colliders that push a particle out.
constexpr int DEPENETRATION_PASSES = 4;

// Distance that a particle's centre keeps from the surface of a collider [m].
inline double contact_distance(const Collider& c, double radius) {
  const double distance = c.margin + radius;
  return c.is_two_sided ? std::max(distance, MIN_TWO_SIDED_DISTANCE) : distance;
}

// Distance from a collider, minus its margin and the particle's radius, and the outward direction.
// Searches no farther than `max_distance`.
inline Sample sample(const Collider& c, const Pose& pose, Vec point, double radius,
                     double max_distance) {
  const Vec p = pose.to_local(point);
  const double* size = c.size;
  Sample nearest_hit{};
  switch (c.shape) {
    case Shape::PLANE:
      nearest_hit = sample_plane(load(size), size[3], p);
      break;
    case Shape::SPHERE:
      nearest_hit = sample_sphere(load(size), size[3], p);
      break;
    case Shape::CAPSULE:
      nearest_hit = sample_capsule(load(size), load(size + 3), size[6], p);
      break;
    case Shape::BOX:
      nearest_hit = sample_box(load(size), p);
      break;
    case Shape::MESH:
      // Farther away it is unknown whether the particle is inside.
      nearest_hit = sample_mesh(c.mesh, c.mesh_root, p,
                                c.is_container ? INF : max_distance + contact_distance(c, radius));
      if (c.is_two_sided) nearest_hit = unsigned_sample(nearest_hit);
      break;
  }
  const Vec out = pose.rotate(nearest_hit.normal);
  const double side = c.is_container ? -1 : 1;
  if (c.is_two_sided) return {nearest_hit.distance - contact_distance(c, radius), out};
  return {side * nearest_hit.distance - c.margin - radius, out * side};
}

// Like `sample`, for a particle with a known earlier position in the collider's frame: if it has
// crossed a two-sided mesh in between, it is inside.
inline Sample sample_after_crossing(const Collider& c, Vec earlier_point, const Pose& pose,
                                    Vec point, double radius, double max_distance) {
  if (!c.is_two_sided || !changes_side(c.mesh, c.mesh_root, earlier_point, pose.to_local(point)))
    return sample(c, pose, point, radius, max_distance);
  const Sample nearest_hit = sample(c, pose, point, radius, INF);
  const double clearance = contact_distance(c, radius);
  return {-(nearest_hit.distance + clearance) - clearance, -nearest_hit.normal};
}

// The path of a particle in the remaining step. Positions may come from an integrator whose
// displacements differ from the velocities, so both are stored: `heading` is the initial rate of
// the position.
struct Path {
  Vec position, heading, velocity, acceleration;
  // Elapsed and remaining time of the step [s].
  double elapsed, remaining;

  Vec position_at(double s) const { return position + heading * s + acceleration * (s * s / 2); }
  Vec velocity_at(double s) const { return velocity + acceleration * s; }
};

// One particle in one step, and all colliders.
class ParticleContacts {
 public:
  // The particle exists from a time within the step [s]; 0 if it existed before.
  ParticleContacts(const Collider* colliders, std::size_t count, double step, double radius,
                   double spawn_time = 0)
      : colliders_(colliders),
        collider_count_(count),
        step_(step),
        spawn_time_(spawn_time),
        radius_(radius) {}

  // Moves the end of the path to where contacts allow; returns the last contact. Without contacts
  // the end stays the same to the last bit.
  Contact resolve(const Particle& before, Particle& after) {
    contact_ = {};
    if (!(step_ > spawn_time_)) return contact_;
    path_ = remaining_path(before, after);
    resting_collider_ = -1;
    culled_bits_ = 0;
    for (std::size_t i = 0; i < std::min(collider_count_, MAX_CULLED_COLLIDERS); ++i)
      if (cannot_hit(colliders_[i])) culled_bits_ |= std::uint64_t{1} << i;
    for (int i = 0; i < MAX_CONTACTS_PER_STEP; ++i) {
      double time = path_.remaining;
      const std::int64_t hit = find_first_hit(time);
      if (hit < 0) break;
      bounce_or_rest(hit, time, i + 1 == MAX_CONTACTS_PER_STEP);
      culled_bits_ = 0;
      after = {path_.position_at(path_.remaining), path_.velocity_at(path_.remaining)};
    }
    depenetrate(before, after);
    return contact_;
  }

 private:
  bool is_culled(std::size_t i) const {
    return i < MAX_CULLED_COLLIDERS && (culled_bits_ >> i & 1);
  }

  // Whether the current path cannot hit a collider.
  bool cannot_hit(const Collider& c) const {
    const Pose pose = pose_at(c, 0);
    const double max_distance = approach_bound(c, pose) * path_.remaining + 2 * TOUCH_DISTANCE;
    if (c.shape == Shape::MESH && !c.is_container && is_beyond_box(c, pose, max_distance))
      return true;
    return sample(c, pose, path_.position, radius_, INF).distance >= max_distance;
  }

  bool is_beyond_box(const Collider& c, const Pose& pose, double max_distance) const {
    const double limit = max_distance + contact_distance(c, radius_);
    const Vec local = pose.to_local(path_.position);
    return squared_box_distance(local, c.mesh.bounds + 6 * c.mesh_root) >= limit * limit;
  }

  // The path between two states, with constant acceleration.
  Path remaining_path(const Particle& before, const Particle& after) const {
    const double remaining = step_ - spawn_time_;
    const Vec acceleration = (after.velocity - before.velocity) * (1 / remaining);
    const Vec chord = (after.position - before.position) * (1 / remaining);
    return {before.position, chord - acceleration * (remaining / 2),
            before.velocity, acceleration,
            spawn_time_,     remaining};
  }

  Pose pose_at(const Collider& c, double s) const {
    return c.motion.pose_at(std::min((path_.elapsed + s) / step_, 1.0));
  }

  Vec surface_velocity(const Collider& c, Vec point, const Pose& pose) const {
    return c.motion.displacement(point, pose) * (1 / step_);
  }

  // Returns the collider that is hit first before a time, and that time; -1 for none.
  std::int64_t find_first_hit(double& time) const {
    std::int64_t hit = -1;
    for (std::size_t i = 0; i < collider_count_; ++i) {
      if (static_cast<std::int64_t>(i) == resting_collider_ || is_culled(i)) continue;
      const double s = hit_time(colliders_[i], time);
      if (s >= 0 && (s < time || (hit < 0 && s <= time))) hit = i, time = s;
    }
    return hit;
  }

  // Upper bound of the particle's speed relative to a collider [m/s].
  double approach_bound(const Collider& c, const Pose& pose) const {
    const Vec surface_velocity = c.motion.translation() * (1 / step_);
    const Vec start_velocity = path_.heading - surface_velocity;
    const Vec end_velocity = start_velocity + path_.acceleration * path_.remaining;
    const double linear_speed = std::max(length(start_velocity), length(end_velocity));
    if (c.motion.angle() == 0) return linear_speed;
    const double arm = length(path_.position - pose.origin) + linear_speed * path_.remaining;
    return linear_speed + c.motion.angle() / step_ * arm;
  }

  // Time at which the particle first touches a collider while approaching it, up to a limit; -1 if
  // it does not. Uses conservative advancement.
  double hit_time(const Collider& c, double time_limit) const {
    Pose pose = pose_at(c, 0);
    const double speed = approach_bound(c, pose),
                 max_distance = speed * time_limit + 2 * TOUCH_DISTANCE;
    Sample nearest_hit = sample(c, pose, path_.position, radius_, max_distance);
    if (nearest_hit.distance > speed * time_limit + TOUCH_DISTANCE ||
        nearest_hit.distance < -INSIDE_DEPTH)
      return -1;
    double s = 0;
    if (nearest_hit.distance <= TOUCH_DISTANCE) {
      const Vec relative_velocity = path_.heading - surface_velocity(c, path_.position, pose);
      const double normal_speed = dot(relative_velocity, nearest_hit.normal);
      const double normal_acceleration = dot(path_.acceleration, nearest_hit.normal);
      if (normal_speed < 0 || (normal_speed == 0 && normal_acceleration < 0)) return 0;
      // Receding: it can come back only after the apex of its path; but it may hit a two-sided
      // collider elsewhere.
      if (!c.is_two_sided)
        s = normal_acceleration < 0 ? -normal_speed / normal_acceleration : time_limit;
    }
    for (int advance = 0; s < time_limit; ++advance) {
      pose = pose_at(c, s);
      const Vec point = path_.position_at(s);
      nearest_hit = sample(c, pose, point, radius_, max_distance);
      if (nearest_hit.distance <= TOUCH_DISTANCE &&
          is_approaching(c, point, pose, nearest_hit.normal, s))
        return s;
      const double min_advance =
          advance < MAX_ADVANCES ? TOUCH_DISTANCE / 2 / speed : path_.remaining / MAX_ADVANCES;
      const double safe_advance = nearest_hit.distance / speed;
      if (c.is_two_sided && min_advance > safe_advance &&
          crosses_between(c, s, std::min(s + min_advance, time_limit)))
        return time_before_crossing(c, s, std::min(s + min_advance, time_limit));
      s += std::max(safe_advance, min_advance);
    }
    return is_entering(c, time_limit) ? time_limit : -1;
  }

  Vec local_at(const Collider& c, double s) const {
    return pose_at(c, s).to_local(path_.position_at(s));
  }

  bool crosses_between(const Collider& c, double from, double to) const {
    return changes_side(c.mesh, c.mesh_root, local_at(c, from), local_at(c, to));
  }

  // The last time before the path crosses a mesh, in an interval in which it does.
  double time_before_crossing(const Collider& c, double from, double to) const {
    for (int k = 0; k < CROSSING_BISECTIONS; ++k) {
      const double middle = (from + to) / 2;
      (crosses_between(c, from, middle) ? to : from) = middle;
    }
    return from;
  }

  bool is_approaching(const Collider& c, Vec point, const Pose& pose, Vec normal, double s) const {
    const Vec path_velocity = path_.heading + path_.acceleration * s;
    return dot(path_velocity - surface_velocity(c, point, pose), normal) < 0;
  }

  // Whether the particle is inside a collider at a time, and approaches it.
  bool is_entering(const Collider& c, double s) const {
    const Pose pose = pose_at(c, s);
    const Vec point = path_.position_at(s);
    const Sample nearest_hit = sample(c, pose, point, radius_, 2 * TOUCH_DISTANCE);
    return nearest_hit.distance < 0 && is_approaching(c, point, pose, nearest_hit.normal, s);
  }

  // Continues after a contact: bounces, or stays on the surface if it would fall back onto it
  // within the step.
  void bounce_or_rest(std::int64_t index, double s, bool is_last) {
    const Collider& c = colliders_[index];
    const Pose pose = pose_at(c, s);
    Vec point = path_.position_at(s);
    const Sample nearest_hit = sample(c, pose, point, radius_, INF);
    if (nearest_hit.distance < 0) point = point - nearest_hit.normal * nearest_hit.distance;
    const Vec collider_velocity = surface_velocity(c, point, pose);
    const Vec relative_velocity = path_.velocity_at(s) - collider_velocity;
    const double normal_speed = dot(relative_velocity, nearest_hit.normal);
    const double normal_acceleration = dot(path_.acceleration, nearest_hit.normal),
                 remaining = path_.remaining - s;
    const double exit_speed = normal_speed < 0 ? -c.restitution * normal_speed : normal_speed;
    const bool is_bouncing = !is_last && exit_speed > -normal_acceleration * remaining / 2;
    const double normal_impulse =
        normal_speed < 0 ? (is_bouncing ? exit_speed - normal_speed : -normal_speed) : 0.0;
    const Vec slip_velocity = with_friction(relative_velocity - nearest_hit.normal * normal_speed,
                                            c.friction * normal_impulse);
    contact_ = {index, Touch::BOUNCED, nearest_hit.normal};
    if (is_bouncing) {
      const Vec velocity = collider_velocity + slip_velocity + nearest_hit.normal * exit_speed;
      path_ = {point, velocity, velocity, path_.acceleration, path_.elapsed + s, remaining};
      resting_collider_ = -1;
      return;
    }
    slide(index, pose, point, slip_velocity, nearest_hit.normal, s);
  }

  // A slip velocity after friction has reduced its magnitude.
  static Vec with_friction(Vec velocity, double reduction) {
    const double speed = length(velocity);
    return speed > reduction ? velocity * (1 - reduction / speed) : Vec{};
  }

  // Stays on a surface until the end of the step, sliding with friction.
  void slide(std::int64_t index, const Pose& pose, Vec point, Vec slip_velocity, Vec normal,
             double s) {
    const Collider& c = colliders_[index];
    const double remaining = path_.remaining - s,
                 normal_acceleration = dot(path_.acceleration, normal);
    const Vec slip_acceleration = path_.acceleration - normal * normal_acceleration;
    const Vec frictionless_slip = slip_velocity + slip_acceleration * remaining;
    const double friction_speed = c.friction * std::max(-normal_acceleration, 0.0) * remaining;
    const Vec end_slip = with_friction(frictionless_slip, friction_speed);
    const double start_speed = length(slip_velocity),
                 excess_friction = friction_speed - length(frictionless_slip);
    const double fraction = excess_friction > 0 && start_speed + excess_friction > 0
                                ? start_speed / (start_speed + excess_friction)
                                : 1.0;
    const Pose end = pose_at(c, path_.remaining);
    const Vec transported = end.to_world(pose.to_local(point));
    const Vec end_position = transported + (slip_velocity + end_slip) * (remaining * fraction / 2);
    const Vec velocity = surface_velocity(c, transported, end) + end_slip;
    const Vec heading = remaining > 0 ? (end_position - point) * (1 / remaining) : Vec{};
    path_ = {point, heading, velocity, {}, path_.elapsed + s, remaining};
    contact_ = {index, Touch::RESTING, normal};
    resting_collider_ = index;
  }

  // Moves a particle out of the colliders that it is inside at the end of a step: at once if it
  // started outside, otherwise no faster than the collider's depenetration speed, which is not
  // added to its velocity.
  void depenetrate(const Particle& before, Particle& after) {
    for (int pass = 0; pass < DEPENETRATION_PASSES; ++pass) {
      bool has_moved = false;
      for (std::size_t i = 0; i < collider_count_; ++i)
        has_moved |= !is_culled(i) && depenetrate_from(i, before, after);
      if (!has_moved) return;
      culled_bits_ = 0;
    }
    move_with_colliders(after);
  }

  // Pushes a particle out of one collider; returns whether it is fully outside now.
  bool depenetrate_from(std::size_t i, const Particle& before, Particle& after) {
    const Collider& c = colliders_[i];
    const Pose end = c.motion.pose_at(1);
    const Sample nearest_hit = sample_after_crossing(c, tested_position(i), end, after.position,
                                                     radius_, search_distance(c));
    if (nearest_hit.distance >= -TOUCH_DISTANCE) return false;
    const Sample start = sample(c, c.motion.pose_at(spawn_time_ / step_), before.position, radius_,
                                search_distance(c));
    const double target_distance =
        start.distance < -INSIDE_DEPTH
            ? std::min(start.distance + c.depenetration * (step_ - spawn_time_), 0.0)
            : 0.0;
    const bool is_resolved = target_distance >= 0;
    contact_ = {static_cast<std::int64_t>(i), is_resolved ? Touch::RESTING : Touch::UNRESOLVED,
                nearest_hit.normal};
    const double normal_speed =
        dot(after.velocity - surface_velocity(c, after.position, end), nearest_hit.normal);
    if (normal_speed < 0) after.velocity = after.velocity - nearest_hit.normal * normal_speed;
    if (target_distance <= nearest_hit.distance) return false;
    after.position = after.position + nearest_hit.normal * (target_distance - nearest_hit.distance);
    return is_resolved;
  }

  // Last tested position of the particle on its path, in the frame of a collider.
  Vec tested_position(std::size_t i) const {
    const bool is_resting = static_cast<std::int64_t>(i) == resting_collider_;
    return local_at(colliders_[i], is_resting ? 0 : path_.remaining);
  }

  // Only meshes use the search distance; inside a mesh every depth counts.
  static double search_distance(const Collider& c) {
    return c.shape == Shape::MESH ? INF : 2 * TOUCH_DISTANCE;
  }

  // Gives a particle that touches colliders from several sides their mean velocity.
  void move_with_colliders(Particle& after) {
    Vec sum;
    int touching_count = 0;
    for (std::size_t i = 0; i < collider_count_; ++i) {
      const Collider& c = colliders_[i];
      const Pose end = c.motion.pose_at(1);
      if (sample(c, end, after.position, radius_, search_distance(c)).distance < INSIDE_DEPTH) {
        sum = sum + surface_velocity(c, after.position, end);
        ++touching_count;
      }
      if (sample(c, end, after.position, radius_, search_distance(c)).distance < -INSIDE_DEPTH)
        contact_.touch = Touch::UNRESOLVED;
    }
    if (contact_.touch == Touch::UNRESOLVED && touching_count > 0)
      after.velocity = sum * (1.0 / touching_count);
  }

  const Collider* colliders_;
  std::size_t collider_count_;
  double step_, spawn_time_, radius_;
  Path path_{};
  // Bit i is set if the path cannot hit collider i.
  std::uint64_t culled_bits_ = 0;
  std::int64_t resting_collider_ = -1;
  Contact contact_;
};

}  // namespace animtool::collide

namespace animtool {

// Builds the colliders from arrays with one row each.
std::vector<collide::Collider> read_colliders(const ColliderArrays& arrays);

}  // namespace animtool
