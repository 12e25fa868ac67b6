// A step of rigid bodies in substeps: forces act, contacts and joints are solved iteratively until
// velocities converge, bodies move, and penetration correction is removed from velocities again
// (Catto 2023, "Solver2D": soft contacts, substeps and relaxation). Bodies without contacts move
// exactly.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Islands with fewer points get more iterations, up to this factor.
constexpr std::size_t SMALL = 512, MOST = 32;
// Largest number of impact stops of an island in a substep, fewer for many pairs; and of rounds and
// searches at one.
constexpr std::size_t LEGS = 32, CROWD = 256;
constexpr int AGAIN = 4, ARRIVES = 16;
// Largest phase of a drive's swing in a substep [rad], the largest factor on substeps for it, and
// the phase above which it is reported.
constexpr double SWING = 0.2, MAX_TIMES = 64, TOO_FAR = 0.5;
// Likewise for drives whose motion exceeds their effective mass.
constexpr double LOSES = 0.02;
// Bodies penetrating by more than this fraction of their size stay awake.
constexpr double SEPARATING = 0.02;

}  // namespace

bool Solver::bounces() {
  find();
  for (const Contact& c : contacts_) {
    if (!(c.material.restitution > 0)) continue;
    const State& a = states_[c.a];
    const std::size_t b = c.b < 0 ? count_ : static_cast<std::size_t>(c.b);
    const Vec spin = spin_of(world_.bodies[c.a], a);
    const Pose pose = pose_of(a), other = c.b < 0 ? c.motion->at(0) : pose_of(states_[b]);
    const double rest = rest_speed(c.a, b, c.material.restitution);
    for (std::size_t k = 0; k < static_cast<std::size_t>(c.count); ++k) {
      const Vec velocity_a = a.velocity + cross(spin, pose.rotated(c.on_a[k]));
      const Vec theirs =
          c.b < 0 ? c.motion->displacement(other.to_world(c.on_b[k]), other) * (1 / step_)
                  : states_[b].velocity +
                        cross(spin_of(world_.bodies[b], states_[b]), other.rotated(c.on_b[k]));
      if (dot(velocity_a - theirs, c.normal) > rest) return true;
    }
  }
  return false;
}

Report Solver::run() {
  if (!has_contacts_) find();
  if (wake()) find();
  make_islands();
  speeds_.assign(count_ + 1, {});
  pushed_.assign(count_ + 1, 0);
  support_counts_.assign(count_, 0);
  poses_.resize(count_);
  for (auto& island : islands_) solve(island);
  store_contacts();
  update_sleep();
  return report_;
}

void Solver::find() {
  contacts_ = find_contacts(world_, states_, colliders_, settings_, step_);
  has_contacts_ = true;
}

void Solver::solve(Island& island) {
  for (const std::size_t i : island.bodies) {
    poses_[i] = pose_of(states_[i]);
    speeds_[i].inverse_mass = world_.bodies[i].inverse_mass;
    speeds_[i].v = states_[i].velocity;
    speeds_[i].w = spin_of(world_.bodies[i], states_[i]);
    refresh(i);
  }
  rows_.assign(island.joints.size(), {});
  choose_substeps(island);
  patches_.clear(), points_.clear();
  patches_.reserve(island.contacts.size()), points_.reserve(MAX_POINTS * island.contacts.size());
  for (const std::size_t k : island.contacts) add_patch(contacts_[k]);
  bouncy_ = std::any_of(patches_.begin(), patches_.end(),
                        [](const Patch& patch) { return patch.restitution > 0; });
  for (int s = 0; s < parts_; ++s) substep(island, s);
  for (const Patch& patch : patches_) {
    save(patch);
    const double slack = SEPARATING * world_.bodies[patch.a].reach;
    for (std::size_t k = patch.begin; k < patch.end; ++k)
      island.separating |= points_[k].current_gap < -slack;
    count_supports(patch);
  }
  for (std::size_t k = 0; k < island.joints.size(); ++k) {
    auto& slots = joint_impulses_[island.joints[k]];
    slots.fill(0);
    const double reach = world_.bodies[world_.joints[island.joints[k]].b].reach;
    for (std::size_t r = 0; r < rows_[k].count; ++r) {
      const Row& row = rows_[k].of[r];
      slots[static_cast<std::size_t>(row.slot)] = row.impulse / substep_;
      const bool rotates = dot(row.line, row.line) == 0;
      const double off = row.kind == Row::LIMIT ? -row.error : std::fabs(row.error);
      island.separating |= row.kind != Row::DRIVE && off > SEPARATING * (rotates ? 1 : reach);
    }
  }
}

void Solver::choose_substeps(const Island& island) {
  resize(settings_.substeps);
  const std::size_t count = island.joints.size();
  drives_.assign(count, {}), hard_ = false;
  const auto is_driven = [&](std::size_t k) { return driven(world_.joints[k]); };
  if (!std::any_of(island.joints.begin(), island.joints.end(), is_driven)) return;
  for (std::size_t k = 0; k < count; ++k) write_rows(island.joints[k], k, 0, true);
  hard_ = update_drive_masses(world_.joints, island.joints, rows_, speeds_, drives_);
  double parts = 1;
  for (std::size_t k = 0; k < count; ++k)
    for (const Drive& drive : drives_[k]) {
      const double swing = frequency_of(world_.joints[island.joints[k]], drive.mass, substep_);
      parts = std::max(parts, swing * substep_ / (drive.moves_mass ? SWING : LOSES));
      const double most = (drive.moves_mass ? TOO_FAR : LOSES) * MAX_TIMES;
      if (swing * substep_ > most)
        report_.record_drive(step_ * most / (swing * substep_), island.joints[k]);
    }
  if (parts > 1)
    resize(settings_.substeps * static_cast<int>(std::ceil(std::min(parts, MAX_TIMES))));
}

void Solver::resize(int parts) {
  const double small = step_ / parts;
  // An impact of the previous island may have changed the time.
  const bool same = small == substep_ && h_ == small;
  parts_ = parts, substep_ = h_ = small;
  if (!same) soften();
}

void Solver::soften() {
  contact_ = Softness::of(STIFF / substep_, CONTACT_DAMPING, h_);
  joint_ = Softness::of(STIFF / substep_, JOINT_DAMPING, h_);
}

void Solver::refresh(std::size_t i) {
  const double* r = poses_[i].rotation;
  const double* e = world_.bodies[i].inverse_inertia.of;
  double* to = speeds_[i].inverse_inertia;
  for (int p = 0; p < 3; ++p)
    for (int q = p; q < 3; ++q) {
      const double sum = r[3 * p] * e[0] * r[3 * q] + r[3 * p + 1] * e[1] * r[3 * q + 1] +
                         r[3 * p + 2] * e[2] * r[3 * q + 2];
      to[3 * p + q] = to[3 * q + p] = sum;
    }
}

void Solver::substep(const Island& island, int s) {
  const double begin = static_cast<double>(s) / parts_;
  const double end = static_cast<double>(s + 1) / parts_;
  const std::size_t joints = island.joints.size();
  // Warm start from the previous step.
  if (s == 0) {
    update_points(begin);
    for (std::size_t k = 0; k < joints; ++k) write_rows(island.joints[k], k, begin, true);
  }
  double left = substep_;
  const int legs = static_cast<int>(
      std::clamp<std::size_t>(CROWD / std::max<std::size_t>(patches_.size(), 1), 1, LEGS));
  for (int leg = 0; bouncy_ && leg < legs; ++leg) {
    const double time = until_impact(island, left, begin, end);
    if (!(time < left)) break;
    left -= time;
    advance(island, time, begin + (end - begin) * (1 - left / substep_));
  }
  advance(island, left, end);
}

void Solver::advance(const Island& island, double time, double end) {
  const std::size_t joints = island.joints.size();
  // Impact impulses are no lasting force: they do not scale with time.
  const double scale = std::min(time / h_, 1.0);
  if (time != h_) {
    h_ = time;
    soften();
    for (std::size_t k = 0; k < joints; ++k)
      write_rows(island.joints[k], k, end - time / step_, false);
  }
  for (const std::size_t i : island.bodies) pushed_[i] = 0;
  for (std::size_t k = 0; k < joints; ++k) begin_drives(world_.joints[island.joints[k]], k);
  for (const std::size_t i : island.bodies) apply_forces(i);
  for (Patch& p : patches_) warm_start(p, scale);
  for (std::size_t k = 0; k < joints; ++k)
    warm_start(world_.joints[island.joints[k]], rows_[k], scale);
  for (std::size_t k = 0; k < joints; ++k) set_curvature(island.joints[k], rows_[k], end);
  iterate(island, true);
  mark(island);
  for (const std::size_t i : island.bodies) move(i);
  update_points(end);
  for (std::size_t k = 0; k < joints; ++k) write_rows(island.joints[k], k, end, false);
  for (std::size_t k = 0; k < joints; ++k) end_drives(world_.joints[island.joints[k]], k);
  for (const std::size_t i : island.bodies) apply_forces(i);
  for (Patch& p : patches_) warm_finish(p);
  for (std::size_t k = 0; k < joints; ++k) warm_finish(world_.joints[island.joints[k]], rows_[k]);
  iterate(island, false);
  mark(island);
  for (const std::size_t i : island.bodies) store_velocity(i);
}

void Solver::apply_forces(std::size_t i) {
  State& s = states_[i];
  const double half = h_ / 2;
  s.velocity = s.velocity + forces_[i] * (world_.bodies[i].inverse_mass * half);
  s.momentum = s.momentum + torques_[i] * half;
  speeds_[i].v = s.velocity;
  speeds_[i].w = spin_of(world_.bodies[i], s);
}

void Solver::iterate(const Island& island, bool pushing) {
  if (patches_.empty() && island.joints.empty()) return;
  const std::size_t size = points_.size() + island.joints.size() * 6;
  const int limit = settings_.iterations * static_cast<int>(std::clamp<std::size_t>(
                                               SMALL / std::max<std::size_t>(size, 1), 1, MOST));
  double change = 0;
  int iteration = 0;
  do {
    change = 0;
    for (std::size_t k = 0; k < island.joints.size(); ++k)
      change = std::max(change, correct(world_.joints[island.joints[k]], rows_[k], pushing));
    const std::size_t patches = patches_.size();
    // Forwards and backwards, so that weight and support both propagate.
    for (std::size_t k = 0; k < patches; ++k)
      change = std::max(change, correct(patches_[iteration % 2 ? patches - 1 - k : k], pushing));
    ++iteration;
  } while (change > settings_.tolerance && iteration < limit);
  report_.iterations += iteration;
  if (!pushing) {
    report_.residual = std::max(report_.residual, change);
    if (change > settings_.tolerance) ++report_.unsolved;
  }
}

void Solver::move(std::size_t i) {
  State& s = states_[i];
  const Body& body = world_.bodies[i];
  const Speed& speed = speeds_[i];
  s.at = s.at + speed.v * h_;
  if (pushed_[i]) s.velocity = speed.v, s.momentum = momentum_of(i);
  rotate_freely(i, s);
  poses_[i] = pose_of(s);
  speeds_[i].w = spin_of(body, s);
  if (!patches_.empty() || !rows_.empty()) refresh(i);
}

void Solver::rotate_freely(std::size_t i, State& s) const {
  const Vec p = unrotate(s.rotation, s.momentum);
  Spin spin{s.rotation, {p.x, p.y, p.z}};
  spin_freely(spin, world_.bodies[i].inverse_inertia, h_, settings_.method);
  s.rotation = spin.q;
  if (settings_.method != Method::SPLITTING)
    s.momentum = rotate(s.rotation, {spin.p[0], spin.p[1], spin.p[2]});
}

Vec Solver::momentum_of(std::size_t i) const {
  const Vec w = poses_[i].unrotated(speeds_[i].w);
  const double* e = world_.bodies[i].inverse_inertia.of;
  const double p[3] = {w.x, w.y, w.z};
  double to[3];
  for (int k = 0; k < 3; ++k) to[k] = e[k] > 0 ? p[k] / e[k] : 0.0;
  return poses_[i].rotated({to[0], to[1], to[2]});
}

void Solver::mark(const Island& island) {
  for (const std::size_t k : island.joints) {
    const Joint& joint = world_.joints[k];
    pushed_[joint.b] = 1;
    if (joint.a >= 0) pushed_[static_cast<std::size_t>(joint.a)] = 1;
  }
  for (const Patch& patch : patches_)
    for (std::size_t k = patch.begin; k < patch.end; ++k)
      if (points_[k].force > 0) {
        pushed_[patch.a] = 1;
        if (patch.b < count_) pushed_[patch.b] = 1;
      }
}

void Solver::store_velocity(std::size_t i) {
  State& s = states_[i];
  if (!pushed_[i]) return;
  s.velocity = speeds_[i].v;
  s.momentum = momentum_of(i);
}

Report step_world(const World& world, std::vector<State>& states,
                  std::vector<StoredContact>& stored,
                  std::vector<std::array<double, ROWS>>& joint_impulses,
                  const std::vector<Vec>& forces, const std::vector<Vec>& torques,
                  const std::vector<collide::Collider>& colliders,
                  const std::vector<collide::Motion>& anchors, const Settings& settings,
                  double step) {
  Solver full(world, states, stored, joint_impulses, forces, torques, colliders, anchors, settings,
              step);
  if (settings.substeps == 1 || !full.bounces()) return full.run();
  // A bouncing body meets others than those in its path: contacts are found again in each substep.
  Settings small = settings;
  small.substeps = 1;
  std::vector<collide::Collider> around = colliders;
  std::vector<collide::Motion> frames = anchors;
  Report report;
  for (int s = 0; s < settings.substeps; ++s) {
    const double begin = static_cast<double>(s) / settings.substeps;
    const double end = static_cast<double>(s + 1) / settings.substeps;
    for (std::size_t i = 0; i < around.size(); ++i)
      around[i].motion = colliders[i].motion.part(begin, end);
    for (std::size_t i = 0; i < frames.size(); ++i) frames[i] = anchors[i].part(begin, end);
    report.add(Solver(world, states, stored, joint_impulses, forces, torques, around, frames, small,
                      step / settings.substeps)
                   .run());
  }
  return report;
}

}  // namespace animtool::rigid
