// Contact points in a step: positions, impulses and corrections.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Largest speed at which initial penetration is resolved [m/s].
constexpr double MAX_PUSH_SPEED = 2;
// Distance within which a contact point is matched to one of the previous step, over the size.
constexpr double MAX_MATCH_DISTANCE_RATIO = 0.1;
// Contact arms are updated if they change by more than this fraction of the body's size.
constexpr double ARM_TOLERANCE = 1e-3;
// Friction that is within this fraction of its limit slides.
constexpr double SLIDING_MARGIN = 1e-6;

}  // namespace

void Solver::count_supports(const Patch& patch) {
  if (!(patch.friction > 0)) return;
  int count = 0;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    const Point& p = points_[k];
    const double limit = patch.friction * p.force * (1 - SLIDING_MARGIN);
    count +=
        p.friction_forces[0] * p.friction_forces[0] + p.friction_forces[1] * p.friction_forces[1] <
        limit * limit;
  }
  const Contact& c = *patch.contact;
  if (world_.shapes[c.first_shape].core.face_count()) support_counts_[patch.a] += count;
  if (patch.b < body_count_ &&
      world_.shapes[static_cast<std::size_t>(c.second_shape)].core.face_count())
    support_counts_[patch.b] += count;
}

void Solver::add_patch(const Contact& c) {
  Patch patch;
  patch.a = c.body_a, patch.b = c.body_b < 0 ? body_count_ : static_cast<std::size_t>(c.body_b);
  patch.contact = &c;
  const Vec normal = patch.normal = c.normal;
  patch.tangents[0] = collide::orthogonal(normal);
  patch.tangents[1] = cross(normal, patch.tangents[0]);
  patch.friction = c.material.friction, patch.restitution = c.material.restitution;
  patch.max_push_speed = c.depenetration > 0 ? c.depenetration : MAX_PUSH_SPEED;
  patch.begin = points_.size();
  patch.radius_sum = c.radius + c.other_radius;
  const double arm_tolerance = ARM_TOLERANCE * world_.bodies[c.body_a].bounding_radius;
  patch.squared_arm_tolerance = arm_tolerance * arm_tolerance;
  const Pose& pose_a = poses_[c.body_a];
  const Pose fixed_pose = c.body_b < 0 ? c.motion->pose_at(0) : poses_[patch.b];
  for (std::size_t k = 0; k < static_cast<std::size_t>(c.count); ++k) {
    Point& p = points_.emplace_back();
    p.local_a = c.local_a[k], p.local_b = c.local_b[k], p.gap = c.gaps[k];
    const Pose& pose_b = c.body_b < 0 ? fixed_pose : poses_[patch.b];
    set_arms(patch, p,
             contact_position(patch, pose_a.to_world(p.local_a), pose_b.to_world(p.local_b)));
  }
  patch.end = points_.size();
  match_stored_contacts(patch);
  patches_.push_back(patch);
}

void Solver::set_arms(const Patch& patch, Point& p, Vec position) {
  const Vec arm_a = p.arm_a = position - states_[patch.a].position;
  const Vec arm_b = p.arm_b = patch.b < body_count_ ? position - states_[patch.b].position : Vec{};
  const Speed &speed_a = speeds_[patch.a], &speed_b = speeds_[patch.b];
  const Vec directions[3] = {patch.normal, patch.tangents[0], patch.tangents[1]};
  for (int d = 0; d < 3; ++d) {
    p.arms_a[d] = cross(arm_a, directions[d]), p.arms_b[d] = cross(arm_b, directions[d]);
    p.responses_a[d] = speed_a.angular_response(p.arms_a[d]),
    p.responses_b[d] = speed_b.angular_response(p.arms_b[d]);
    const double inverse_mass = speed_a.inverse_mass + speed_b.inverse_mass +
                                dot(p.arms_a[d], p.responses_a[d]) +
                                dot(p.arms_b[d], p.responses_b[d]);
    (d ? p.tangent_masses[d - 1] : p.mass) = inverse_mass > 0 ? 1 / inverse_mass : 0;
  }
  // The same mass for both tangents, so that friction is aligned with sliding.
  p.tangent_masses[0] = p.tangent_masses[1] = std::min(p.tangent_masses[0], p.tangent_masses[1]);
}

void Solver::match_stored_contacts(Patch& patch) {
  const Contact& c = *patch.contact;
  const auto first = static_cast<std::int64_t>(c.first_shape);
  auto begin = std::lower_bound(stored_contacts_.begin(), stored_contacts_.end(), c,
                                [&](const StoredContact& k, const Contact&) {
                                  return k.first_shape != first ? k.first_shape < first
                                                                : k.second_shape < c.second_shape;
                                });
  const double match_distance = MAX_MATCH_DISTANCE_RATIO * world_.bodies[c.body_a].bounding_radius;
  std::uint32_t matched_bits = 0;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    double min_squared = match_distance * match_distance;
    int best = -1, i = 0;
    for (auto it = begin; it != stored_contacts_.end() && it->first_shape == first &&
                          it->second_shape == c.second_shape && i < 32;
         ++it, ++i) {
      const Vec offset = it->position - p.local_a;
      if (!(matched_bits >> i & 1) && dot(offset, offset) < min_squared)
        min_squared = dot(offset, offset), best = i;
    }
    if (best < 0) continue;
    matched_bits |= 1u << best;
    const Vec force = poses_[c.body_a].rotate((begin + best)->force) * h_;
    p.force = std::max(dot(force, patch.normal), 0.0);
    p.friction_forces[0] = dot(force, patch.tangents[0]),
    p.friction_forces[1] = dot(force, patch.tangents[1]);
  }
}

void Solver::store_patch(const Patch& patch) {
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    const Point& p = points_[k];
    const Vec force = patch.normal * p.force + patch.tangents[0] * p.friction_forces[0] +
                      patch.tangents[1] * p.friction_forces[1];
    // In the frame of the body at the start of the step, in which it rotates little.
    const Vec local_force = poses_[patch.a].inverse_rotate(force) * (1 / substep_);
    next_contacts_.push_back({static_cast<std::int64_t>(patch.contact->first_shape),
                              patch.contact->second_shape, p.local_a, local_force});
    if (-p.current_gap > report_.max_depth) {
      report_.max_depth = -p.current_gap;
      report_.first_shape = static_cast<std::int64_t>(patch.contact->first_shape);
      report_.second_shape = patch.contact->second_shape;
    }
    if (p.force > 0) ++report_.contact_count;
  }
}

void Solver::update_points(double fraction) {
  for (Patch& patch : patches_) {
    const Vec centre = states_[patch.a].position;
    const Pose& pose = poses_[patch.a];
    const bool is_collider = patch.b == body_count_;
    const collide::Motion* motion = patch.contact->motion;
    const Pose other_pose = is_collider ? motion->pose_at(fraction) : poses_[patch.b];
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      const Vec point_a = centre + pose.rotate(p.local_a), point_b = other_pose.to_world(p.local_b);
      p.current_gap = p.gap + dot(patch.normal, point_b - point_a) - patch.radius_sum;
      const Vec position = contact_position(patch, point_a, point_b),
                arm_change = position - centre - p.arm_a;
      const Vec other_arm_change =
          is_collider ? Vec{} : position - states_[patch.b].position - p.arm_b;
      if (dot(arm_change, arm_change) + dot(other_arm_change, other_arm_change) >
          patch.squared_arm_tolerance)
        set_arms(patch, p, position);
      if (is_collider && motion->is_moving())
        p.slide_velocity = motion->displacement(point_b, other_pose) * (1 / step_);
      p.bias_speed = dot(p.slide_velocity, patch.normal);
    }
  }
}

void Solver::warm_start(Patch& patch, double scale) {
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    p.force *= scale / 2, p.friction_forces[0] *= scale / 2, p.friction_forces[1] *= scale / 2;
    p.half_impulses[0] = p.force, p.half_impulses[1] = p.friction_forces[0],
    p.half_impulses[2] = p.friction_forces[1];
    apply_half_impulses(patch, p);
  }
}

void Solver::warm_start_second_half(Patch& patch) {
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    if (p.force == 0) continue;
    p.force += p.half_impulses[0], p.friction_forces[0] += p.half_impulses[1],
        p.friction_forces[1] += p.half_impulses[2];
    apply_half_impulses(patch, p);
  }
}

void Solver::apply_half_impulses(const Patch& patch, const Point& p) {
  if (p.half_impulses[0] == 0) return;
  apply(patch.a, patch.b, patch.normal, p.responses_a[0], p.responses_b[0], p.half_impulses[0]);
  for (int d = 0; d < 2; ++d)
    apply(patch.a, patch.b, patch.tangents[d], p.responses_a[d + 1], p.responses_b[d + 1],
          p.half_impulses[d + 1]);
}

double Solver::correct_velocities(Patch& patch, bool correct_positions) {
  double max_change = 0;
  const double h = h_;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    if (p.will_bounce) continue;
    double bias = 0, mass = 1, relaxation = 0;
    if (p.current_gap > 0) {
      // Approaching bodies have not arrived: only the position correction acts.
      if (!correct_positions && p.force == 0) continue;
      bias = correct_positions ? p.current_gap / h : 0;
    } else if (correct_positions) {
      bias = std::max(contact_softness_.bias_rate * p.current_gap, -patch.max_push_speed);
      mass = contact_softness_.mass_factor, relaxation = contact_softness_.impulse_factor;
    }
    const double speed = separation_speed(patch, p);
    const double change = -p.mass * mass * (speed + bias) - relaxation * p.force;
    const double force = std::max(p.force + change, 0.0), force_change = force - p.force;
    p.force = force;
    if (force_change != 0) {
      apply(patch.a, patch.b, patch.normal, p.responses_a[0], p.responses_b[0], force_change);
      max_change = std::max(max_change, std::fabs(force_change) / p.mass);
    }
  }
  if (!(patch.friction > 0)) return max_change;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    if (p.force == 0 && p.friction_forces[0] == 0 && p.friction_forces[1] == 0) continue;
    const Speed &a = speeds_[patch.a], &b = speeds_[patch.b];
    const Vec relative_velocity = b.v - a.v + p.slide_velocity;
    double target[2];
    for (int d = 0; d < 2; ++d) {
      const double speed = dot(patch.tangents[d], relative_velocity) + dot(p.arms_b[d + 1], b.w) -
                           dot(p.arms_a[d + 1], a.w);
      target[d] = p.friction_forces[d] - p.tangent_masses[d] * speed;
    }
    const double limit = patch.friction * p.force;
    const double magnitude = std::sqrt(target[0] * target[0] + target[1] * target[1]);
    const double fraction = magnitude > limit ? limit / magnitude : 1;
    for (int d = 0; d < 2; ++d) {
      const double force_change = target[d] * fraction - p.friction_forces[d];
      p.friction_forces[d] += force_change;
      if (force_change == 0) continue;
      apply(patch.a, patch.b, patch.tangents[d], p.responses_a[d + 1], p.responses_b[d + 1],
            force_change);
      max_change = std::max(max_change, std::fabs(force_change) / p.tangent_masses[d]);
    }
  }
  return max_change;
}

}  // namespace animtool::rigid
