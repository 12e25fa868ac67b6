// Contact points in a step: positions, impulses and corrections.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Largest speed at which initial penetration is resolved [m/s].
constexpr double MAX_PUSH_SPEED = 2;
// A contact point is matched to one of the previous step within this distance, over the size.
constexpr double MATCH_DISTANCE = 0.1;
// Contact arms are updated if bodies rotate by more than this fraction of their size.
constexpr double ARM_TOLERANCE = 1e-3;
// Friction this close to its limit slides.
constexpr double SLIDING = 1e-6;

}  // namespace

void Solver::count_supports(const Patch& patch) {
  if (!(patch.friction > 0)) return;
  int count = 0;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    const Point& p = points_[k];
    const double limit = patch.friction * p.force * (1 - SLIDING);
    count += p.across[0] * p.across[0] + p.across[1] * p.across[1] < limit * limit;
  }
  const Contact& c = *patch.contact;
  if (world_.shapes[c.first].core.faces()) support_counts_[patch.a] += count;
  if (patch.b < count_ && world_.shapes[static_cast<std::size_t>(c.second)].core.faces())
    support_counts_[patch.b] += count;
}

void Solver::add_patch(const Contact& c) {
  Patch patch;
  patch.a = c.a, patch.b = c.b < 0 ? count_ : static_cast<std::size_t>(c.b);
  patch.contact = &c;
  const Vec n = patch.normal = c.normal;
  patch.tangents[0] = collide::across(n);
  patch.tangents[1] = cross(n, patch.tangents[0]);
  patch.friction = c.material.friction, patch.restitution = c.material.restitution;
  patch.push = c.depenetration > 0 ? c.depenetration : MAX_PUSH_SPEED;
  patch.begin = points_.size();
  patch.skin = c.radius + c.other_radius;
  const double size = ARM_TOLERANCE * world_.bodies[c.a].reach;
  patch.squared_arm_tolerance = size * size;
  const Pose& pose_a = poses_[c.a];
  const Pose fixed_pose = c.b < 0 ? c.motion->at(0) : poses_[patch.b];
  for (std::size_t k = 0; k < static_cast<std::size_t>(c.count); ++k) {
    Point& p = points_.emplace_back();
    p.on_a = c.on_a[k], p.on_b = c.on_b[k], p.gap = c.gaps[k];
    const Pose& pose_b = c.b < 0 ? fixed_pose : poses_[patch.b];
    set_arms(patch, p, touching_point(patch, pose_a.to_world(p.on_a), pose_b.to_world(p.on_b)));
  }
  patch.end = points_.size();
  match_stored(patch);
  patches_.push_back(patch);
}

void Solver::set_arms(const Patch& patch, Point& p, Vec at) {
  const Vec at_a = p.arm_a = at - states_[patch.a].at;
  const Vec at_b = p.arm_b = patch.b < count_ ? at - states_[patch.b].at : Vec{};
  const Speed &sa = speeds_[patch.a], &sb = speeds_[patch.b];
  const Vec lines[3] = {patch.normal, patch.tangents[0], patch.tangents[1]};
  for (int d = 0; d < 3; ++d) {
    p.arms_a[d] = cross(at_a, lines[d]), p.arms_b[d] = cross(at_b, lines[d]);
    p.responses_a[d] = sa.angular_response(p.arms_a[d]),
    p.responses_b[d] = sb.angular_response(p.arms_b[d]);
    const double k = sa.inverse_mass + sb.inverse_mass + dot(p.arms_a[d], p.responses_a[d]) +
                     dot(p.arms_b[d], p.responses_b[d]);
    (d ? p.masses[d - 1] : p.mass) = k > 0 ? 1 / k : 0;
  }
  // One arm for both, so that friction is aligned with sliding.
  p.masses[0] = p.masses[1] = std::min(p.masses[0], p.masses[1]);
}

void Solver::match_stored(Patch& patch) {
  const Contact& c = *patch.contact;
  const auto first = static_cast<std::int64_t>(c.first);
  auto begin = std::lower_bound(stored_contacts_.begin(), stored_contacts_.end(), c,
                                [&](const StoredContact& k, const Contact&) {
                                  return k.first != first ? k.first < first : k.second < c.second;
                                });
  const double size = MATCH_DISTANCE * world_.bodies[c.a].reach;
  std::uint32_t matched = 0;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    double least = size * size;
    int best = -1, i = 0;
    for (auto it = begin;
         it != stored_contacts_.end() && it->first == first && it->second == c.second && i < 32;
         ++it, ++i) {
      const Vec off = it->at - p.on_a;
      if (!(matched >> i & 1) && dot(off, off) < least) least = dot(off, off), best = i;
    }
    if (best < 0) continue;
    matched |= 1u << best;
    const Vec force = poses_[c.a].rotated((begin + best)->force) * h_;
    p.force = std::max(dot(force, patch.normal), 0.0);
    p.across[0] = dot(force, patch.tangents[0]), p.across[1] = dot(force, patch.tangents[1]);
  }
}

void Solver::save(const Patch& patch) {
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    const Point& p = points_[k];
    const Vec force =
        patch.normal * p.force + patch.tangents[0] * p.across[0] + patch.tangents[1] * p.across[1];
    // In the body's frame at the start of the step, in which it rotates little.
    const Vec local_force = poses_[patch.a].unrotated(force) * (1 / substep_);
    next_contacts_.push_back({static_cast<std::int64_t>(patch.contact->first),
                              patch.contact->second, p.on_a, local_force});
    if (-p.current_gap > report_.deepest) {
      report_.deepest = -p.current_gap;
      report_.first = static_cast<std::int64_t>(patch.contact->first);
      report_.second = patch.contact->second;
    }
    if (p.force > 0) ++report_.contacts;
  }
}

void Solver::update_points(double fraction) {
  for (Patch& patch : patches_) {
    const Vec at = states_[patch.a].at;
    const Pose& pose = poses_[patch.a];
    const bool fixed = patch.b == count_;
    const collide::Motion* motion = patch.contact->motion;
    const Pose other = fixed ? motion->at(fraction) : poses_[patch.b];
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      const Vec at_a = at + pose.rotated(p.on_a), far = other.to_world(p.on_b);
      p.current_gap = p.gap + dot(patch.normal, far - at_a) - patch.skin;
      const Vec mid = touching_point(patch, at_a, far), off = mid - at - p.arm_a;
      const Vec far_off = fixed ? Vec{} : mid - states_[patch.b].at - p.arm_b;
      if (dot(off, off) + dot(far_off, far_off) > patch.squared_arm_tolerance)
        set_arms(patch, p, mid);
      if (fixed && motion->moves()) p.slide = motion->displacement(far, other) * (1 / step_);
      p.bias_speed = dot(p.slide, patch.normal);
    }
  }
}

void Solver::warm_start(Patch& patch, double scale) {
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    p.force *= scale / 2, p.across[0] *= scale / 2, p.across[1] *= scale / 2;
    p.half[0] = p.force, p.half[1] = p.across[0], p.half[2] = p.across[1];
    apply_half(patch, p);
  }
}

void Solver::warm_finish(Patch& patch) {
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    if (p.force == 0) continue;
    p.force += p.half[0], p.across[0] += p.half[1], p.across[1] += p.half[2];
    apply_half(patch, p);
  }
}

void Solver::apply_half(const Patch& patch, const Point& p) {
  if (p.half[0] == 0) return;
  apply(patch.a, patch.b, patch.normal, p.responses_a[0], p.responses_b[0], p.half[0]);
  for (int d = 0; d < 2; ++d)
    apply(patch.a, patch.b, patch.tangents[d], p.responses_a[d + 1], p.responses_b[d + 1],
          p.half[d + 1]);
}

double Solver::correct(Patch& patch, bool pushing) {
  double most = 0;
  const double h = h_;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    if (p.will_bounce) continue;
    double bias = 0, mass = 1, leak = 0;
    if (p.current_gap > 0) {
      // Approaching bodies have not arrived: only positions count.
      if (!pushing && p.force == 0) continue;
      bias = pushing ? p.current_gap / h : 0;
    } else if (pushing) {
      bias = std::max(contact_.bias * p.current_gap, -patch.push);
      mass = contact_.mass, leak = contact_.leak;
    }
    const double speed = approach(patch, p);
    const double change = -p.mass * mass * (speed + bias) - leak * p.force;
    const double force = std::max(p.force + change, 0.0), by = force - p.force;
    p.force = force;
    if (by != 0) {
      apply(patch.a, patch.b, patch.normal, p.responses_a[0], p.responses_b[0], by);
      most = std::max(most, std::fabs(by) / p.mass);
    }
  }
  if (!(patch.friction > 0)) return most;
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    Point& p = points_[k];
    if (p.force == 0 && p.across[0] == 0 && p.across[1] == 0) continue;
    const Speed &a = speeds_[patch.a], &b = speeds_[patch.b];
    const Vec off = b.v - a.v + p.slide;
    double to[2];
    for (int d = 0; d < 2; ++d) {
      const double speed =
          dot(patch.tangents[d], off) + dot(p.arms_b[d + 1], b.w) - dot(p.arms_a[d + 1], a.w);
      to[d] = p.across[d] - p.masses[d] * speed;
    }
    const double limit = patch.friction * p.force;
    const double size = std::sqrt(to[0] * to[0] + to[1] * to[1]);
    const double fraction = size > limit ? limit / size : 1;
    for (int d = 0; d < 2; ++d) {
      const double by = to[d] * fraction - p.across[d];
      p.across[d] += by;
      if (by == 0) continue;
      apply(patch.a, patch.b, patch.tangents[d], p.responses_a[d + 1], p.responses_b[d + 1], by);
      most = std::max(most, std::fabs(by) / p.masses[d]);
    }
  }
  return most;
}

}  // namespace animtool::rigid
