// A step of rigid bodies in substeps: forces act, contacts and joints are solved iteratively until
// velocities converge, bodies move, and penetration correction is removed from velocities again
// (Catto 2023, "Solver2D": soft contacts, substeps and relaxation). Bodies without contacts move
// exactly.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Islands with fewer equations than this get more iterations, up to a factor.
constexpr std::size_t SMALL_ISLAND_EQUATIONS = 512, MAX_ITERATION_FACTOR = 32;
// Largest number of impact stops of an island in a substep; smaller for many patches. Largest
// number of impact rounds and root iterations at a stop.
constexpr std::size_t MAX_IMPACT_STOPS = 32, MAX_PATCH_IMPACT_STOPS = 256;
constexpr int MAX_IMPACT_ROUNDS = 4, MAX_ROOT_STEPS = 16;
// Largest phase of a drive's oscillation in a substep [rad], the largest factor on the number of
// substeps for it, and the phase above which it is reported.
constexpr double MAX_DRIVE_PHASE = 0.2, MAX_SUBSTEP_FACTOR = 64, REPORTED_PHASE = 0.5;
// The same two phases for drives that cannot move their effective mass.
constexpr double MAX_CONSTRAINED_PHASE = 0.02;
// Bodies penetrating by more than this fraction of their size stay awake.
constexpr double MIN_AWAKE_DEPTH_RATIO = 0.02;

}  // namespace

bool Solver::has_bounces() {
  update_contacts();
  for (const Contact& c : contacts_) {
    if (!(c.material.restitution > 0)) continue;
    const State& a = states_[c.body_a];
    const std::size_t b = c.body_b < 0 ? body_count_ : static_cast<std::size_t>(c.body_b);
    const Vec spin = angular_velocity_of(world_.bodies[c.body_a], a);
    const Pose pose = pose_of(a),
               other_pose = c.body_b < 0 ? c.motion->pose_at(0) : pose_of(states_[b]);
    const double min_speed = rest_speed(c.body_a, b, c.material.restitution);
    for (std::size_t k = 0; k < static_cast<std::size_t>(c.count); ++k) {
      const Vec velocity_a = a.velocity + cross(spin, pose.rotate(c.local_a[k]));
      const Vec velocity_b =
          c.body_b < 0
              ? c.motion->displacement(other_pose.to_world(c.local_b[k]), other_pose) * (1 / step_)
              : states_[b].velocity + cross(angular_velocity_of(world_.bodies[b], states_[b]),
                                            other_pose.rotate(c.local_b[k]));
      if (dot(velocity_a - velocity_b, c.normal) > min_speed) return true;
    }
  }
  return false;
}

Report Solver::run() {
  if (!are_contacts_known_) update_contacts();
  if (wake_bodies()) update_contacts();
  build_islands();
  speeds_.assign(body_count_ + 1, {});
  is_pushed_.assign(body_count_ + 1, 0);
  support_counts_.assign(body_count_, 0);
  poses_.resize(body_count_);
  for (auto& island : islands_) solve_island(island);
  store_contacts();
  update_sleep();
  return report_;
}

void Solver::update_contacts() {
  contacts_ = find_contacts(world_, states_, colliders_, settings_, step_);
  are_contacts_known_ = true;
}

void Solver::solve_island(Island& island) {
  for (const std::size_t i : island.bodies) {
    poses_[i] = pose_of(states_[i]);
    speeds_[i].inverse_mass = world_.bodies[i].inverse_mass;
    speeds_[i].v = states_[i].velocity;
    speeds_[i].w = angular_velocity_of(world_.bodies[i], states_[i]);
    update_inertia(i);
  }
  rows_.assign(island.joints.size(), {});
  choose_substeps(island);
  patches_.clear(), points_.clear();
  patches_.reserve(island.contacts.size()),
      points_.reserve(MAX_MANIFOLD_POINTS * island.contacts.size());
  for (const std::size_t k : island.contacts) add_patch(contacts_[k]);
  has_restitution_ = std::any_of(patches_.begin(), patches_.end(),
                                 [](const Patch& patch) { return patch.restitution > 0; });
  for (int k = 0; k < substep_count_; ++k) advance_substep(island, k);
  for (const Patch& patch : patches_) {
    store_patch(patch);
    const double slack = MIN_AWAKE_DEPTH_RATIO * world_.bodies[patch.a].bounding_radius;
    for (std::size_t k = patch.begin; k < patch.end; ++k)
      island.has_penetration |= points_[k].current_gap < -slack;
    count_supports(patch);
  }
  for (std::size_t k = 0; k < island.joints.size(); ++k) {
    auto& slots = joint_impulses_[island.joints[k]];
    slots.fill(0);
    const double bounding_radius = world_.bodies[world_.joints[island.joints[k]].b].bounding_radius;
    for (std::size_t r = 0; r < rows_[k].count; ++r) {
      const Row& row = rows_[k].entries[r];
      slots[static_cast<std::size_t>(row.slot)] = row.impulse / substep_;
      const bool is_rotation = dot(row.line, row.line) == 0;
      const double depth = row.kind == Row::LIMIT ? -row.error : std::fabs(row.error);
      island.has_penetration |= row.kind != Row::DRIVE &&
                                depth > MIN_AWAKE_DEPTH_RATIO * (is_rotation ? 1 : bounding_radius);
    }
  }
}

void Solver::choose_substeps(const Island& island) {
  set_substeps(settings_.substeps);
  const std::size_t count = island.joints.size();
  drives_.assign(count, {}), are_joints_rigid_ = false;
  const auto is_driven = [&](std::size_t k) { return has_drive(world_.joints[k]); };
  if (!std::any_of(island.joints.begin(), island.joints.end(), is_driven)) return;
  for (std::size_t k = 0; k < count; ++k) update_rows(island.joints[k], k, 0, true);
  are_joints_rigid_ = update_drive_masses(world_.joints, island.joints, rows_, speeds_, drives_);
  double substep_factor = 1;
  for (std::size_t k = 0; k < count; ++k)
    for (const Drive& drive : drives_[k]) {
      const double frequency =
          drive_frequency(world_.joints[island.joints[k]], drive.mass, substep_);
      substep_factor = std::max(
          substep_factor,
          frequency * substep_ / (drive.is_mass_free ? MAX_DRIVE_PHASE : MAX_CONSTRAINED_PHASE));
      const double max_phase =
          (drive.is_mass_free ? REPORTED_PHASE : MAX_CONSTRAINED_PHASE) * MAX_SUBSTEP_FACTOR;
      if (frequency * substep_ > max_phase)
        report_.record_drive(step_ * max_phase / (frequency * substep_), island.joints[k]);
    }
  if (substep_factor > 1)
    set_substeps(settings_.substeps *
                 static_cast<int>(std::ceil(std::min(substep_factor, MAX_SUBSTEP_FACTOR))));
}

void Solver::set_substeps(int count) {
  const double length = step_ / count;
  // An impact of the previous island may have changed the time.
  const bool is_same = length == substep_ && h_ == length;
  substep_count_ = count, substep_ = h_ = length;
  if (!is_same) update_softness();
}

void Solver::update_softness() {
  contact_softness_ = Softness::from_frequency(STIFFNESS_RATIO / substep_, CONTACT_DAMPING, h_);
  joint_softness_ = Softness::from_frequency(STIFFNESS_RATIO / substep_, JOINT_DAMPING, h_);
}

void Solver::update_inertia(std::size_t i) {
  const double* rotation = poses_[i].rotation;
  const double* inverse_inertia = world_.bodies[i].inverse_inertia.entries;
  double* world_inertia = speeds_[i].inverse_inertia;
  for (int p = 0; p < 3; ++p)
    for (int q = p; q < 3; ++q) {
      const double sum = rotation[3 * p] * inverse_inertia[0] * rotation[3 * q] +
                         rotation[3 * p + 1] * inverse_inertia[1] * rotation[3 * q + 1] +
                         rotation[3 * p + 2] * inverse_inertia[2] * rotation[3 * q + 2];
      world_inertia[3 * p + q] = world_inertia[3 * q + p] = sum;
    }
}

void Solver::advance_substep(const Island& island, int index) {
  const double begin_fraction = static_cast<double>(index) / substep_count_;
  const double end_fraction = static_cast<double>(index + 1) / substep_count_;
  const std::size_t joint_count = island.joints.size();
  // Warm start from the previous step.
  if (index == 0) {
    update_points(begin_fraction);
    for (std::size_t k = 0; k < joint_count; ++k)
      update_rows(island.joints[k], k, begin_fraction, true);
  }
  double remaining = substep_;
  const int max_stops = static_cast<int>(std::clamp<std::size_t>(
      MAX_PATCH_IMPACT_STOPS / std::max<std::size_t>(patches_.size(), 1), 1, MAX_IMPACT_STOPS));
  for (int stop = 0; has_restitution_ && stop < max_stops; ++stop) {
    const double time = time_to_impact(island, remaining, begin_fraction, end_fraction);
    if (!(time < remaining)) break;
    remaining -= time;
    advance(island, time,
            begin_fraction + (end_fraction - begin_fraction) * (1 - remaining / substep_));
  }
  advance(island, remaining, end_fraction);
}

void Solver::advance(const Island& island, double duration, double end_fraction) {
  const std::size_t joint_count = island.joints.size();
  // Impact impulses are not lasting forces: they do not scale with time.
  const double scale = std::min(duration / h_, 1.0);
  if (duration != h_) {
    h_ = duration;
    update_softness();
    for (std::size_t k = 0; k < joint_count; ++k)
      update_rows(island.joints[k], k, end_fraction - duration / step_, false);
  }
  for (const std::size_t i : island.bodies) is_pushed_[i] = 0;
  for (std::size_t k = 0; k < joint_count; ++k) begin_drives(world_.joints[island.joints[k]], k);
  for (const std::size_t i : island.bodies) apply_forces(i);
  for (Patch& p : patches_) warm_start(p, scale);
  for (std::size_t k = 0; k < joint_count; ++k)
    warm_start(world_.joints[island.joints[k]], rows_[k], scale);
  for (std::size_t k = 0; k < joint_count; ++k)
    set_curvature(island.joints[k], rows_[k], end_fraction);
  iterate(island, true);
  mark_pushed(island);
  for (const std::size_t i : island.bodies) move_body(i);
  update_points(end_fraction);
  for (std::size_t k = 0; k < joint_count; ++k)
    update_rows(island.joints[k], k, end_fraction, false);
  for (std::size_t k = 0; k < joint_count; ++k) end_drives(world_.joints[island.joints[k]], k);
  for (const std::size_t i : island.bodies) apply_forces(i);
  for (Patch& p : patches_) warm_start_second_half(p);
  for (std::size_t k = 0; k < joint_count; ++k)
    warm_start_second_half(world_.joints[island.joints[k]], rows_[k]);
  iterate(island, false);
  mark_pushed(island);
  for (const std::size_t i : island.bodies) store_velocity(i);
}

void Solver::apply_forces(std::size_t i) {
  State& s = states_[i];
  const double half = h_ / 2;
  s.velocity = s.velocity + forces_[i] * (world_.bodies[i].inverse_mass * half);
  s.momentum = s.momentum + torques_[i] * half;
  speeds_[i].v = s.velocity;
  speeds_[i].w = angular_velocity_of(world_.bodies[i], s);
}

void Solver::iterate(const Island& island, bool correct_positions) {
  if (patches_.empty() && island.joints.empty()) return;
  const std::size_t equation_count = points_.size() + island.joints.size() * 6;
  const int max_iterations = settings_.max_iterations *
                             static_cast<int>(std::clamp<std::size_t>(
                                 SMALL_ISLAND_EQUATIONS / std::max<std::size_t>(equation_count, 1),
                                 1, MAX_ITERATION_FACTOR));
  double change = 0;
  int iteration = 0;
  do {
    change = 0;
    for (std::size_t k = 0; k < island.joints.size(); ++k)
      change = std::max(
          change, correct_velocities(world_.joints[island.joints[k]], rows_[k], correct_positions));
    const std::size_t patch_count = patches_.size();
    // Forwards and backwards, so that weight and support both propagate.
    for (std::size_t k = 0; k < patch_count; ++k)
      change = std::max(
          change,
          correct_velocities(patches_[iteration % 2 ? patch_count - 1 - k : k], correct_positions));
    ++iteration;
  } while (change > settings_.tolerance && iteration < max_iterations);
  report_.iteration_count += iteration;
  if (!correct_positions) {
    report_.residual = std::max(report_.residual, change);
    if (change > settings_.tolerance) ++report_.unsolved_count;
  }
}

void Solver::move_body(std::size_t i) {
  State& s = states_[i];
  const Body& body = world_.bodies[i];
  const Speed& speed = speeds_[i];
  s.position = s.position + speed.v * h_;
  if (is_pushed_[i]) s.velocity = speed.v, s.momentum = momentum_of(i);
  rotate_freely(i, s);
  poses_[i] = pose_of(s);
  speeds_[i].w = angular_velocity_of(body, s);
  if (!patches_.empty() || !rows_.empty()) update_inertia(i);
}

void Solver::rotate_freely(std::size_t i, State& s) const {
  const Vec p = inverse_rotate(s.rotation, s.momentum);
  Spin spin{s.rotation, {p.x, p.y, p.z}};
  spin_freely(spin, world_.bodies[i].inverse_inertia, h_, settings_.method);
  s.rotation = spin.q;
  if (settings_.method != Method::SPLITTING)
    s.momentum = rotate(s.rotation, {spin.p[0], spin.p[1], spin.p[2]});
}

Vec Solver::momentum_of(std::size_t i) const {
  const Vec w = poses_[i].inverse_rotate(speeds_[i].w);
  const double* inverse_inertia = world_.bodies[i].inverse_inertia.entries;
  const double angular_velocity[3] = {w.x, w.y, w.z};
  double local_momentum[3];
  for (int k = 0; k < 3; ++k)
    local_momentum[k] = inverse_inertia[k] > 0 ? angular_velocity[k] / inverse_inertia[k] : 0.0;
  return poses_[i].rotate({local_momentum[0], local_momentum[1], local_momentum[2]});
}

void Solver::mark_pushed(const Island& island) {
  for (const std::size_t k : island.joints) {
    const Joint& joint = world_.joints[k];
    is_pushed_[joint.b] = 1;
    if (joint.a >= 0) is_pushed_[static_cast<std::size_t>(joint.a)] = 1;
  }
  for (const Patch& patch : patches_)
    for (std::size_t k = patch.begin; k < patch.end; ++k)
      if (points_[k].force > 0) {
        is_pushed_[patch.a] = 1;
        if (patch.b < body_count_) is_pushed_[patch.b] = 1;
      }
}

void Solver::store_velocity(std::size_t i) {
  State& s = states_[i];
  if (!is_pushed_[i]) return;
  s.velocity = speeds_[i].v;
  s.momentum = momentum_of(i);
}

Report step_world(const World& world, std::vector<State>& states,
                  std::vector<StoredContact>& stored,
                  std::vector<std::array<double, JOINT_SLOT_COUNT>>& joint_impulses,
                  const std::vector<Vec>& forces, const std::vector<Vec>& torques,
                  const std::vector<collide::Collider>& colliders,
                  const std::vector<collide::Motion>& anchors, const Settings& settings,
                  double step) {
  Solver solver(world, states, stored, joint_impulses, forces, torques, colliders, anchors,
                settings, step);
  if (settings.substeps == 1 || !solver.has_bounces()) return solver.run();
  // A bouncing body collides with others than those in its path: contacts are searched again in
  // each substep.
  Settings substep_settings = settings;
  substep_settings.substeps = 1;
  std::vector<collide::Collider> substep_colliders = colliders;
  std::vector<collide::Motion> substep_anchors = anchors;
  Report report;
  for (int i = 0; i < settings.substeps; ++i) {
    const double begin = static_cast<double>(i) / settings.substeps;
    const double end = static_cast<double>(i + 1) / settings.substeps;
    for (std::size_t k = 0; k < substep_colliders.size(); ++k)
      substep_colliders[k].motion = colliders[k].motion.sub_motion(begin, end);
    for (std::size_t k = 0; k < substep_anchors.size(); ++k)
      substep_anchors[k] = anchors[k].sub_motion(begin, end);
    report.add(Solver(world, states, stored, joint_impulses, forces, torques, substep_colliders,
                      substep_anchors, substep_settings, step / settings.substeps)
                   .run());
  }
  return report;
}

}  // namespace animtool::rigid
