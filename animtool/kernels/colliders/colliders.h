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

// Kinds of colliders.
struct Collider {
  Shape shape = Shape::PLANE;
  // Plane: normal, offset. Sphere: centre, radius. Capsule: both ends, radius. Box: half
  // extents. In the frame of the collider [m].
  double size[7] = {0, 1, 0, 0, 0, 0, 0};
  Mesh mesh = {};
  std::int32_t root = 0;
  Motion motion;
  // Keeps particles inside, not outside.
  bool container = false;
  // A mesh that can be hit from both sides.
  bool two_sided = false;
  // Coefficients of restitution and of Coulomb friction [1]; margin [m]; speed at which a particle
  // that starts inside is moved out [m/s].
  double restitution = 0, friction = 0, margin = 0, depenetration = 1;
};

// The last contact event of a particle in a step.
enum class Touch : std::int64_t { NONE, BOUNCED, RESTS, UNRESOLVED };

struct Contact {
  std::int64_t collider = -1;
  Touch touch = Touch::NONE;
  Vec normal;
};

struct Particle {
  Vec position, velocity;
};

// Contacts of one particle in one step.
constexpr int MAX_CONTACTS = 8;
// Advancements along a path before it is stepped through in fixed fractions.
constexpr int MAX_ADVANCES = 64;
// Bisections of the fraction in which a surface is crossed.
constexpr int HALVINGS = 24;
// Number of colliders that can be marked as out of reach of a path.
constexpr std::size_t MAX_MARKED = 64;
// Iterations of moving out of all colliders.
constexpr int DEPENETRATION_PASSES = 4;

constexpr double FAR = std::numeric_limits<double>::infinity();

// Distance that a particle keeps from the surface of a collider [m].
inline double contact_distance(const Collider& c, double radius) {
  const double off = c.margin + radius;
  return c.two_sided ? std::max(off, SHELL) : off;
}

// Distance from a collider, minus its margin and the particle's radius, and the direction out of
// it. Looks no farther than a reach.
inline Sample sample(const Collider& c, const Pose& pose, Vec point, double radius, double reach) {
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
      // Beyond the reach it is unknown whether the particle is inside.
      nearest_hit =
          sample_mesh(c.mesh, c.root, p, c.container ? FAR : reach + contact_distance(c, radius));
      if (c.two_sided) nearest_hit = unsided(nearest_hit);
      break;
  }
  const Vec out = pose.rotated(nearest_hit.normal);
  const double side = c.container ? -1 : 1;
  if (c.two_sided) return {nearest_hit.distance - contact_distance(c, radius), out};
  return {side * nearest_hit.distance - c.margin - radius, out * side};
}

// The same for a particle whose earlier position in the collider's frame is given: if it has
// crossed a two-sided mesh since, it is inside.
inline Sample sample_since(const Collider& c, Vec from, const Pose& pose, Vec point, double radius,
                           double reach) {
  if (!c.two_sided || !crosses_mesh(c.mesh, c.root, from, pose.to_local(point)))
    return sample(c, pose, point, radius, reach);
  const Sample nearest_hit = sample(c, pose, point, radius, FAR);
  const double off = contact_distance(c, radius);
  return {-(nearest_hit.distance + off) - off, -nearest_hit.normal};
}

// The path of a particle in the rest of a step. Positions may come from an integrator whose
// displacements differ from the velocities, so both are stored.
struct Path {
  Vec position, heading, velocity, acceleration;
  // Elapsed and remaining time of the step [s].
  double clock, remaining;

  Vec at(double s) const { return position + heading * s + acceleration * (s * s / 2); }
  Vec velocity_at(double s) const { return velocity + acceleration * s; }
};

// One particle in one step, and all colliders.
class ParticleContacts {
 public:
  // The particle exists from a time within the step; 0 if it existed before.
  ParticleContacts(const Collider* colliders, std::size_t count, double step, double radius,
                   double begin = 0)
      : colliders_(colliders), count_(count), step_(step), begin_(begin), radius_(radius) {}

  // Moves the end of the path to where contacts allow. Without contacts it stays the same to the
  // last bit.
  Contact resolve(const Particle& before, Particle& after) {
    contact_ = {};
    if (!(step_ > begin_)) return contact_;
    path_ = remaining_path(before, after);
    resting_on_ = -1;
    out_of_reach_ = 0;
    for (std::size_t i = 0; i < std::min(count_, MAX_MARKED); ++i)
      if (out_of_reach(colliders_[i])) out_of_reach_ |= std::uint64_t{1} << i;
    for (int i = 0; i < MAX_CONTACTS; ++i) {
      double time = path_.remaining;
      const std::int64_t hit = first_hit(time);
      if (hit < 0) break;
      bounce_or_rest(hit, time, i + 1 == MAX_CONTACTS);
      out_of_reach_ = 0;
      after = {path_.at(path_.remaining), path_.velocity_at(path_.remaining)};
    }
    depenetrate(before, after);
    return contact_;
  }

 private:
  bool is_out_of_reach(std::size_t i) const { return i < MAX_MARKED && (out_of_reach_ >> i & 1); }

  // Whether the current path cannot hit a collider.
  bool out_of_reach(const Collider& c) const {
    const Pose pose = pose_at(c, 0);
    const double reach = approach_bound(c, pose) * path_.remaining + 2 * TOUCH;
    if (c.shape == Shape::MESH && !c.container && is_beyond_box(c, pose, reach)) return true;
    return sample(c, pose, path_.position, radius_, FAR).distance >= reach;
  }

  bool is_beyond_box(const Collider& c, const Pose& pose, double reach) const {
    const double full = reach + contact_distance(c, radius_);
    const Vec local = pose.to_local(path_.position);
    return squared_to_box(local, c.mesh.bounds + 6 * c.root) >= full * full;
  }

  Path remaining_path(const Particle& before, const Particle& after) const {
    const double remaining = step_ - begin_;
    const Vec acceleration = (after.velocity - before.velocity) * (1 / remaining);
    const Vec chord = (after.position - before.position) * (1 / remaining);
    return {before.position, chord - acceleration * (remaining / 2),
            before.velocity, acceleration,
            begin_,          remaining};
  }

  Pose pose_at(const Collider& c, double s) const {
    return c.motion.at(std::min((path_.clock + s) / step_, 1.0));
  }

  Vec surface_velocity(const Collider& c, Vec point, const Pose& pose) const {
    return c.motion.displacement(point, pose) * (1 / step_);
  }

  std::int64_t first_hit(double& time) const {
    std::int64_t hit = -1;
    for (std::size_t i = 0; i < count_; ++i) {
      if (static_cast<std::int64_t>(i) == resting_on_ || is_out_of_reach(i)) continue;
      const double s = hit_time(colliders_[i], time);
      if (s >= 0 && (s < time || (hit < 0 && s <= time))) hit = i, time = s;
    }
    return hit;
  }

  // Upper bound of the particle's speed relative to the collider [m/s].
  double approach_bound(const Collider& c, const Pose& pose) const {
    const Vec surface_shift = c.motion.travel() * (1 / step_);
    const Vec first = path_.heading - surface_shift;
    const Vec last = first + path_.acceleration * path_.remaining;
    const double straight = std::max(length(first), length(last));
    if (c.motion.angle() == 0) return straight;
    const double arm = length(path_.position - pose.origin) + straight * path_.remaining;
    return straight + c.motion.angle() / step_ * arm;
  }

  // Time at which the particle first touches a collider while approaching it, up to a limit; -1 if
  // never. Uses conservative advancement.
  double hit_time(const Collider& c, double until) const {
    Pose pose = pose_at(c, 0);
    const double speed = approach_bound(c, pose), reach = speed * until + 2 * TOUCH;
    Sample nearest_hit = sample(c, pose, path_.position, radius_, reach);
    if (nearest_hit.distance > speed * until + TOUCH || nearest_hit.distance < -INSIDE) return -1;
    double s = 0;
    if (nearest_hit.distance <= TOUCH) {
      const Vec relative = path_.heading - surface_velocity(c, path_.position, pose);
      const double out = dot(relative, nearest_hit.normal);
      const double normal_acceleration = dot(path_.acceleration, nearest_hit.normal);
      if (out < 0 || (out == 0 && normal_acceleration < 0)) return 0;
      // Receding: it can come back only after the apex of its path; but it may hit a two-sided
      // collider elsewhere.
      if (!c.two_sided) s = normal_acceleration < 0 ? -out / normal_acceleration : until;
    }
    for (int advance = 0; s < until; ++advance) {
      pose = pose_at(c, s);
      const Vec point = path_.at(s);
      nearest_hit = sample(c, pose, point, radius_, reach);
      if (nearest_hit.distance <= TOUCH && approaches(c, point, pose, nearest_hit.normal, s))
        return s;
      const double min_advance =
          advance < MAX_ADVANCES ? TOUCH / 2 / speed : path_.remaining / MAX_ADVANCES;
      const double safe = nearest_hit.distance / speed;
      if (c.two_sided && min_advance > safe && crosses(c, s, std::min(s + min_advance, until)))
        return time_before_crossing(c, s, std::min(s + min_advance, until));
      s += std::max(safe, min_advance);
    }
    return ends_inside(c, until) ? until : -1;
  }

  Vec local_at(const Collider& c, double s) const { return pose_at(c, s).to_local(path_.at(s)); }

  bool crosses(const Collider& c, double from, double to) const {
    return crosses_mesh(c.mesh, c.root, local_at(c, from), local_at(c, to));
  }

  // The last time before the path crosses a mesh, for a span in which it does.
  double time_before_crossing(const Collider& c, double from, double to) const {
    for (int k = 0; k < HALVINGS; ++k) {
      const double middle = (from + to) / 2;
      (crosses(c, from, middle) ? to : from) = middle;
    }
    return from;
  }

  bool approaches(const Collider& c, Vec point, const Pose& pose, Vec normal, double s) const {
    const Vec moving = path_.heading + path_.acceleration * s;
    return dot(moving - surface_velocity(c, point, pose), normal) < 0;
  }

  bool ends_inside(const Collider& c, double s) const {
    const Pose pose = pose_at(c, s);
    const Vec point = path_.at(s);
    const Sample nearest_hit = sample(c, pose, point, radius_, 2 * TOUCH);
    return nearest_hit.distance < 0 && approaches(c, point, pose, nearest_hit.normal, s);
  }

  // Continues after a contact: bounces, or stays on the surface if it would fall back onto it
  // within the step.
  void bounce_or_rest(std::int64_t index, double s, bool last) {
    const Collider& c = colliders_[index];
    const Pose pose = pose_at(c, s);
    Vec point = path_.at(s);
    const Sample nearest_hit = sample(c, pose, point, radius_, FAR);
    if (nearest_hit.distance < 0) point = point - nearest_hit.normal * nearest_hit.distance;
    const Vec surface = surface_velocity(c, point, pose);
    const Vec relative = path_.velocity_at(s) - surface;
    const double normal_speed = dot(relative, nearest_hit.normal);
    const double normal_acceleration = dot(path_.acceleration, nearest_hit.normal),
                 remaining = path_.remaining - s;
    const double out = normal_speed < 0 ? -c.restitution * normal_speed : normal_speed;
    const bool bounces = !last && out > -normal_acceleration * remaining / 2;
    const double normal_impulse =
        normal_speed < 0 ? (bounces ? out - normal_speed : -normal_speed) : 0.0;
    const Vec along =
        with_friction(relative - nearest_hit.normal * normal_speed, c.friction * normal_impulse);
    contact_ = {index, Touch::BOUNCED, nearest_hit.normal};
    if (bounces) {
      const Vec velocity = surface + along + nearest_hit.normal * out;
      path_ = {point, velocity, velocity, path_.acceleration, path_.clock + s, remaining};
      resting_on_ = -1;
      return;
    }
    slide(index, pose, point, along, nearest_hit.normal, s);
  }

  static Vec with_friction(Vec velocity, double by) {
    const double speed = length(velocity);
    return speed > by ? velocity * (1 - by / speed) : Vec{};
  }

  // Stays on a surface until the end of the step, sliding with friction.
  void slide(std::int64_t index, const Pose& pose, Vec point, Vec along, Vec normal, double s) {
    const Collider& c = colliders_[index];
    const double remaining = path_.remaining - s,
                 normal_acceleration = dot(path_.acceleration, normal);
    const Vec pull = path_.acceleration - normal * normal_acceleration;
    const Vec free = along + pull * remaining;
    const double friction_speed = c.friction * std::max(-normal_acceleration, 0.0) * remaining;
    const Vec slid = with_friction(free, friction_speed);
    const double speed = length(along), rest = friction_speed - length(free);
    const double fraction = rest > 0 && speed + rest > 0 ? speed / (speed + rest) : 1.0;
    const Pose end = pose_at(c, path_.remaining);
    const Vec transported = end.to_world(pose.to_local(point));
    const Vec goal = transported + (along + slid) * (remaining * fraction / 2);
    const Vec velocity = surface_velocity(c, transported, end) + slid;
    const Vec heading = remaining > 0 ? (goal - point) * (1 / remaining) : Vec{};
    path_ = {point, heading, velocity, {}, path_.clock + s, remaining};
    contact_ = {index, Touch::RESTS, normal};
    resting_on_ = index;
  }

  // Moves a particle out of the colliders that it is inside at the end of a step: at once if it
  // started outside, otherwise no faster than the collider's depenetration speed, which is not
  // added to its velocity.
  void depenetrate(const Particle& before, Particle& after) {
    for (int pass = 0; pass < DEPENETRATION_PASSES; ++pass) {
      bool moved = false;
      for (std::size_t i = 0; i < count_; ++i)
        moved |= !is_out_of_reach(i) && depenetrate_from(i, before, after);
      if (!moved) return;
      out_of_reach_ = 0;
    }
    move_with_colliders(after);
  }

  bool depenetrate_from(std::size_t i, const Particle& before, Particle& after) {
    const Collider& c = colliders_[i];
    const Pose end = c.motion.at(1);
    const Sample nearest_hit =
        sample_since(c, tested_position(i), end, after.position, radius_, reach_inside(c));
    if (nearest_hit.distance >= -TOUCH) return false;
    const Sample start =
        sample(c, c.motion.at(begin_ / step_), before.position, radius_, reach_inside(c));
    const double goal = start.distance < -INSIDE
                            ? std::min(start.distance + c.depenetration * (step_ - begin_), 0.0)
                            : 0.0;
    const bool out = goal >= 0;
    contact_ = {static_cast<std::int64_t>(i), out ? Touch::RESTS : Touch::UNRESOLVED,
                nearest_hit.normal};
    const double normal_speed =
        dot(after.velocity - surface_velocity(c, after.position, end), nearest_hit.normal);
    if (normal_speed < 0) after.velocity = after.velocity - nearest_hit.normal * normal_speed;
    if (goal <= nearest_hit.distance) return false;
    after.position = after.position + nearest_hit.normal * (goal - nearest_hit.distance);
    return out;
  }

  // Last position of the particle in the frame of a collider, on the part of the path that has
  // been tested.
  Vec tested_position(std::size_t i) const {
    const bool slid = static_cast<std::int64_t>(i) == resting_on_;
    return local_at(colliders_[i], slid ? 0 : path_.remaining);
  }

  // Only meshes use the reach; inside a mesh every depth counts.
  static double reach_inside(const Collider& c) { return c.shape == Shape::MESH ? FAR : 2 * TOUCH; }

  // A particle held by colliders from several sides moves with them.
  void move_with_colliders(Particle& after) {
    Vec sum;
    int friction_speed = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      const Collider& c = colliders_[i];
      const Pose end = c.motion.at(1);
      if (sample(c, end, after.position, radius_, reach_inside(c)).distance < INSIDE) {
        sum = sum + surface_velocity(c, after.position, end);
        ++friction_speed;
      }
      if (sample(c, end, after.position, radius_, reach_inside(c)).distance < -INSIDE)
        contact_.touch = Touch::UNRESOLVED;
    }
    if (contact_.touch == Touch::UNRESOLVED && friction_speed > 0)
      after.velocity = sum * (1.0 / friction_speed);
  }

  const Collider* colliders_;
  std::size_t count_;
  double step_, begin_, radius_;
  Path path_{};
  // A bit for each of the first colliders: set if the path cannot hit it.
  std::uint64_t out_of_reach_ = 0;
  std::int64_t resting_on_ = -1;
  Contact contact_;
};

}  // namespace animtool::collide

namespace animtool {

std::vector<collide::Collider> read_colliders(const ColliderArrays& arrays);

}  // namespace animtool
