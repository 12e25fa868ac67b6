// Particles of springs against colliders.
#include "springs/contacts.h"

#include <algorithm>

#include "base/checks.h"

namespace animtool {

namespace {

using collide::Collider;
using collide::load;
using collide::Mesh;
using collide::Motion;
using collide::Pose;
using collide::Rod;
using collide::Sample;
using collide::Shape;
using collide::store;
using collide::Vec;

// Impact speed, in steps of gravity, below which a contact is resting.
constexpr double RESTING = 2;
// Iterations over all colliders.
constexpr int MAX_ITERATIONS = 3;
// Impulse, moment, mass.
constexpr std::size_t IMPULSE_WIDTH = 7;
// Factor of the radius for edge midpoints, which cut corners.
constexpr double MIDPOINT_FACTOR = 0.25;
// Initial slack of mesh caches, over the size of the mesh.
constexpr double PATCH_SIZE = 1e-3;
// Fraction of that to begin with: on a fine mesh, too many triangles are near.
constexpr double FIRST_SLACK = 0.25;

double thickness_of(const Collider& c, double radius) {
  if (c.container) return collide::FAR;
  switch (c.shape) {
    case Shape::PLANE:
      return collide::FAR;
    case Shape::SPHERE:
      return c.size[3];
    case Shape::CAPSULE:
      return c.size[6];
    case Shape::BOX:
      return std::min({c.size[0], c.size[1], c.size[2]});
    // With less, a particle at most reaches the surface.
    case Shape::MESH:
      return collide::contact_distance(c, radius);
  }
  return 0;
}

// Adds the impulses of two spans of time.
std::vector<double> sum_impulses(const std::vector<double>& first,
                                 const std::vector<double>& second) {
  std::vector<double> sum(first);
  for (std::size_t k = 0; k < sum.size(); ++k)
    sum[k] =
        k % IMPULSE_WIDTH == IMPULSE_WIDTH - 1 ? std::max(sum[k], second[k]) : sum[k] + second[k];
  return sum;
}

Rod::Axis axis_between(Vec a, Vec b) {
  Rod::Axis axis;
  const Vec along = b - a;
  const double squared = dot(along, along);
  store(a, axis.from);
  store(along, axis.along);
  axis.inverse = squared > 0 ? 1 / squared : 0;
  const Vec out = squared > 0 ? collide::across(along * (1 / std::sqrt(squared))) : Vec{0, 1, 0};
  store(out, axis.outward);
  return axis;
}

Sample sampled(const StepCollider& c, const Rod::Axis& axis, const Pose& pose, Vec point,
               double radius) {
  if (!c.is_rod) return sample(c.collider, pose, point, radius, collide::FAR);
  const auto hit = collide::sample_rod(axis, c.rod.radius, point);
  return {hit.distance, hit.normal};
}

}  // namespace

Sample StepCollider::before(Vec point, double radius) const {
  if (surface >= 0) {
    Collider begun_mesh = collider;
    begun_mesh.mesh.fraction = elapsed;
    return sample(begun_mesh, begin, point, radius, collide::FAR);
  }
  return sampled(*this, rod.begin, begin, point, radius);
}

Sample StepCollider::after(Vec point, double radius) const {
  return sampled(*this, rod.end, end, point, radius);
}

double StepCollider::travel(Vec drift) const {
  if (surface >= 0) return shift + length(drift);
  if (!is_rod) return length(collider.motion.travel() - drift);
  // Clamp to the ends of the axis.
  const Vec first = load(rod.end.from) - load(rod.begin.from) - drift;
  const Vec last = first + (load(rod.end.along) - load(rod.begin.along));
  return std::max(length(first), length(last));
}

double StepCollider::thickness(double radius) const { return thickness_of(collider, radius); }

bool StepCollider::sweep(double h, double radius, Vec from, Vec& to, double* v) const {
  // A moving mesh is tested at the end of the step, in a frame that moves with it.
  const Vec transported = surface >= 0 ? load(rod.travel) : Vec{}, start = from + transported;
  if (!(length(to - start) > thickness(radius))) return false;
  // Particles that start inside are moved out at the depenetration speed.
  if (before(from, radius).distance < -collide::INSIDE) return false;
  const Vec speed = (to - start) * (1 / h);
  collide::Particle last{to, speed};
  collide::ParticleContacts contacts(&collider, 1, h, radius);
  if (contacts.resolve({start, speed}, last).collider < 0) return false;
  to = last.position;
  if (v) store(last.velocity, v);
  return true;
}

MovingColliders::MovingColliders(const std::optional<SpringColliders>& colliders,
                                 std::size_t particles, std::int64_t cells)
    : particles_(particles) {
  if (!colliders) return;
  const auto& [arrays, poses, radius, depths, tolerance, surfaces] = *colliders;
  colliders_ = read_colliders(arrays);
  check::numbers("colliders.poses", poses,
                 {static_cast<std::size_t>(cells), colliders_.size(), 2, 7});
  check::not_negative("colliders.radius", radius);
  check::not_negative("colliders.tolerance", tolerance);
  if (depths) {
    const bool all = depths->shape(0) == colliders_.size() + surfaces.size();
    depth_rows_ = colliders_.size() + (all ? surfaces.size() : 0);
    check::numbers("colliders.depths", *depths, {depth_rows_, particles});
  }
  poses_ = poses.data();
  radius_ = radius;
  if (depths) depths_ = depths->data();
  tolerance_ = tolerance;
}

bool MovingColliders::is_continuous(std::int64_t cell) const {
  const std::size_t row = 14 * colliders_.size();
  const double* pose = poses(cell);
  for (std::size_t c = 0; c < row; c += 14)
    if (!std::equal(pose + c, pose + c + 7, pose + c + 7 - row)) return false;
  return true;
}

void MovingColliders::steps(std::int64_t cell, int substeps, double h,
                            std::vector<StepCollider>& out) const {
  std::vector<Motion> full;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    const double* pose = poses(cell) + 14 * c;
    full.emplace_back(pose, pose + 7);
  }
  for (int step = 0; step < substeps; ++step)
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      out.push_back(step_collider(
          colliders_[c], full[c].part(double(step) / substeps, double(step + 1) / substeps), h));
}

StepCollider MovingColliders::step_collider(const Collider& c, const Motion& motion,
                                            double h) const {
  StepCollider built{};
  built.collider = c;
  built.collider.motion = motion;
  built.begin = motion.at(0);
  built.end = motion.at(1);
  built.is_rod = !c.container && (c.shape == Shape::CAPSULE || c.shape == Shape::SPHERE);
  Rod& rod = built.rod;
  store(motion.travel(), rod.travel);
  store(motion.rotation(), rod.rotation);
  store(built.end.origin, rod.origin);
  rod.friction = c.friction;
  rod.max_rise = c.depenetration * h;
  if (!built.is_rod) return built;
  const bool ball = c.shape == Shape::SPHERE;
  const Vec a = load(c.size), b = ball ? a : load(c.size + 3);
  const Vec a0 = built.begin.to_world(a), b0 = built.begin.to_world(b);
  const Vec a1 = built.end.to_world(a), b1 = built.end.to_world(b);
  rod.begin = axis_between(a0, b0);
  rod.end = axis_between(a1, b1);
  rod.radius = c.size[ball ? 3 : 6] + c.margin + radius_;
  return built;
}

SpringContacts::SpringContacts(const std::optional<SpringColliders>& colliders,
                               const SpringNetwork& network, std::int64_t cells, bool midpoints)
    : network_(network),
      colliders_(colliders, network.particles(), cells),
      faces_(network, colliders_.radius()),
      count_(colliders_.size()),
      cells_(cells),
      has_midpoints_(midpoints) {
  if (!colliders) return;
  const std::size_t particles = network.particles() + (midpoints ? network.edges.size() / 2 : 0);
  for (std::size_t c = 0; c < count_; ++c) faces_.add(colliders_[c]);
  for (const SpringSurface& one : std::get<5>(*colliders)) surfaces_.emplace_back(one, cells);
  count_ += surfaces_.size();
  make_patches(particles);
  past_impulses_.assign(IMPULSE_WIDTH * colliders_.size(), 0.0);
  cell_impulses_ = past_impulses_;
  clearances_.assign(particles, 0.0);
  arms_.assign(particles, 0.0);
}

void SpringContacts::make_patches(std::size_t particles) {
  for (std::size_t c = 0; c < count_; ++c) {
    const bool rigid = c < colliders_.size();
    const double margin = rigid ? colliders_[c].margin : surfaces_[c - colliders_.size()].margin();
    const double contact_distance = colliders_.radius() + (rigid ? margin : 0);
    contact_distances_.push_back(colliders_.radius() + margin);
    const double* box = nullptr;
    if (!rigid)
      box = surfaces_[c - colliders_.size()].box();
    else if (colliders_[c].shape == Shape::MESH)
      box = colliders_[c].mesh.bounds + 6 * colliders_[c].root;
    patched_.push_back(box ? static_cast<std::int32_t>(patches_.size()) : -1);
    if (box)
      patches_.emplace_back(
          particles,
          FIRST_SLACK * std::max(contact_distance, PATCH_SIZE * length(load(box + 3) - load(box))));
  }
}

void SpringContacts::begin_cell(std::int64_t cell, int substeps, double h) {
  if (!any()) return;
  substeps_ = substeps;
  h_ = h;
  if (cell != last_) past_impulses_ = sum_impulses(past_impulses_, cell_impulses_);
  std::fill(cell_impulses_.begin(), cell_impulses_.end(), 0.0);
  rigid_.clear();
  colliders_.steps(cell, substeps, h, rigid_);
  // A teleported collider invalidates the cache.
  const bool again = cell == last_;
  bool known = again || (cell == last_ + 1 && (last_ < 0 || colliders_.is_continuous(cell)));
  begin_surfaces(cell, known);
  add_surfaces();
  if (again) clearances_ = start_clearances_, arms_ = start_arms_;
  if (!known) std::fill(clearances_.begin(), clearances_.end(), 0.0);
  start_clearances_ = clearances_, start_arms_ = arms_;
  last_ = cell;
}

void SpringContacts::begin_surfaces(std::int64_t cell, bool& known) {
  for (std::size_t s = 0; s < surfaces_.size(); ++s) {
    if (surfaces_[s].begin_cell(cell, h_ * substeps_)) continue;
    known = false;
    patches_[static_cast<std::size_t>(patched_[colliders_.size() + s])].invalidate();
  }
}

void SpringContacts::add_surfaces() {
  cell_.clear();
  for (int step = 0; step < substeps_; ++step) {
    const auto first = rigid_.begin() + step * static_cast<std::ptrdiff_t>(colliders_.size());
    cell_.insert(cell_.end(), first, first + static_cast<std::ptrdiff_t>(colliders_.size()));
    for (std::size_t s = 0; s < surfaces_.size(); ++s) {
      StepCollider built{};
      const double begun = surfaces_[s].knot_fraction(double(step) / substeps_);
      const double ended = surfaces_[s].knot_fraction(double(step + 1) / substeps_);
      built.collider = surfaces_[s].collider(ended);
      built.surface = static_cast<std::int32_t>(s);
      built.elapsed = begun;
      built.duration = ended - begun;
      built.shift = surfaces_[s].travel() * built.duration;
      built.rod.friction = built.collider.friction;
      built.rod.max_rise = built.collider.depenetration * h_;
      cell_.push_back(built);
    }
  }
}

Out<double, 2> SpringContacts::impulses() const {
  const std::vector<double> sum = sum_impulses(past_impulses_, cell_impulses_);
  Out<double, 2> rows(sum.size() / IMPULSE_WIDTH, IMPULSE_WIDTH);
  std::copy(sum.begin(), sum.end(), rows.get());
  return rows;
}

bool SpringContacts::resolve(int step, std::vector<double>& before, std::vector<double>& x,
                             std::vector<double>* v, std::vector<std::uint8_t>* marks) {
  if (!any()) return false;
  step_colliders_ = cell_.data() + static_cast<std::size_t>(step) * count_;
  double travel = 0, angle = 0;
  for (std::size_t c = 0; c < count_; ++c) {
    travel = std::max(travel, step_colliders_[c].travel({}));
    angle = std::max(angle, step_colliders_[c].rotation());
  }
  masses_.assign(colliders_.size(), 0.0);
  min_impact_speed_ = RESTING * h_ * std::sqrt(dot3(network_.gravity, network_.gravity));
  std::int64_t moved = 0, inside = 0;
  const double reach = faces_.reach();
  nearby_.clear();
  for (std::size_t n = 0; n < network_.particles(); ++n) {
    if (network_.inverse_masses[n] == 0) {
      if (faces_.any()) nearby_.push_back(static_cast<std::int32_t>(n));
      continue;
    }
    if (marks && !(*marks)[n]) continue;
    double *at = x.data() + ROW * n, shift = travel + angle * arms_[n];
    double* from = before.data() + ROW * n;
    for (std::size_t k = 0; k < 3; ++k) shift += std::abs(at[k] - from[k]);
    clearances_[n] -= shift;
    if (clearances_[n] <= reach) nearby_.push_back(static_cast<std::int32_t>(n));
    if (clearances_[n] > 0) continue;
    const double mass = 1 / network_.inverse_masses[n];
    moved += resolve_particle(n, mass, from, at, v ? v->data() + ROW * n : nullptr);
    inside += nearest_ < -colliders_.tolerance();
  }
  for (std::size_t c = 0; c < masses_.size(); ++c) {
    double& largest_mass = cell_impulses_[IMPULSE_WIDTH * c + IMPULSE_WIDTH - 1];
    largest_mass = std::max(largest_mass, masses_[c]);
  }
  if (has_midpoints_) resolve_midpoints(travel, angle, {before, x, v}, marks);
  touched = std::max(touched, moved);
  if (!marks && last_ + 1 == cells_ && step + 1 == substeps_) unresolved = inside;
  const bool faces = !nearby_.empty() && resolve_faces({before, x, v});
  if (faces && marks)
    for (const std::int32_t n : nearby_) (*marks)[static_cast<std::size_t>(n)] = 1;
  return moved > 0 || faces;
}

void SpringContacts::resolve_midpoints(double travel, double angle, StepRows rows,
                                       std::vector<std::uint8_t>* marks) {
  const std::size_t particles = network_.particles();
  for (std::size_t e = 0; e < network_.edges.size() / 2; ++e) {
    const std::int32_t* ends = &network_.edges[2 * e];
    const auto first = static_cast<std::size_t>(ends[0]), last = static_cast<std::size_t>(ends[1]);
    const double i = network_.inverse_masses[first], j = network_.inverse_masses[last];
    if (i + j == 0) continue;
    if (marks && !(*marks)[first] && !(*marks)[last]) continue;
    double *p = &rows.x[ROW * first], *q = &rows.x[ROW * last];
    double *was = &rows.before[ROW * first], *stood = &rows.before[ROW * last];
    double to[3], from[3], shift = travel + angle * arms_[particles + e];
    for (std::size_t k = 0; k < 3; ++k) {
      to[k] = (p[k] + q[k]) / 2, from[k] = (was[k] + stood[k]) / 2;
      shift += std::abs(to[k] - from[k]);
    }
    clearances_[particles + e] -= shift;
    if (clearances_[particles + e] > 0) continue;
    const Vec ended = load(to), begun = load(from);
    if (!resolve_particle(particles + e, 4 / (i + j), from, to, nullptr)) continue;
    if (marks) (*marks)[first] = (*marks)[last] = 1;
    const Vec by = (load(to) - ended) * (2 / (i + j));
    const Vec back = (load(from) - begun) * (2 / (i + j));
    clearances_[first] -= i * length(by), clearances_[last] -= j * length(by);
    store(load(p) + by * i, p), store(load(q) + by * j, q);
    store(load(was) + back * i, was), store(load(stood) + back * j, stood);
  }
}

double SpringContacts::depth(std::size_t c, std::size_t n) const {
  const std::size_t particles = network_.particles();
  if (n < particles) return colliders_.depth(c, n);
  const std::int32_t* ends = &network_.edges[2 * (n - particles)];
  const double least = std::min(colliders_.depth(c, static_cast<std::size_t>(ends[0])),
                                colliders_.depth(c, static_cast<std::size_t>(ends[1])));
  return least - contact_distances_[c] * MIDPOINT_FACTOR;
}

bool SpringContacts::resolve_faces(StepRows rows) {
  bool moved = false;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    if (!faces_.resolve(c, step_colliders_[c], h_, nearby_, rows)) continue;
    moved = true;
    for (const FaceContacts::MovedParticle& one : faces_.moved) {
      const auto n = static_cast<std::size_t>(one.particle);
      clearances_[n] -= one.shift;
      record_impulse(c, 1 / network_.inverse_masses[n], load(&rows.x[ROW * n]), one.change);
    }
  }
  return moved;
}

double SpringContacts::clearance(std::size_t n, Vec x) {
  double clear = collide::FAR;
  for (std::size_t c = 0; c < count_; ++c)
    clear = std::min(clear, query(c, n, true, x).sample.distance - depth(c, n));
  return clear;
}

void SpringContacts::update_clearance(std::size_t n, Vec x, double clear) {
  double arm = 0;
  for (std::size_t c = 0; c < count_; ++c)
    arm = std::max(arm, length(x - step_colliders_[c].end.origin));
  clearances_[n] = std::max(clear, 0.0);
  arms_[n] = arm + 2 * clearances_[n];
}

Mesh SpringContacts::mesh_at(const StepCollider& c, bool end) const {
  Mesh mesh = c.collider.mesh;
  if (!end) mesh.fraction = c.elapsed;
  return mesh;
}

SpringContacts::PatchHit SpringContacts::query(std::size_t index, std::size_t n, bool end,
                                               Vec point) {
  const StepCollider& c = step_colliders_[index];
  const double radius = colliders_.radius();
  if (!c.is_mesh()) return {end ? c.after(point, radius) : c.before(point, radius), -1};
  const Mesh mesh = mesh_at(c, end);
  const Pose& pose = end ? c.end : c.begin;
  const double contact_distance = collide::contact_distance(c.collider, radius),
               side = c.collider.container ? -1 : 1;
  MeshShift gone;
  KnotBoxes boxes{};
  if (c.surface >= 0) {
    const auto& surface = surfaces_[static_cast<std::size_t>(c.surface)];
    gone = surface.shift_until(mesh.fraction);
    boxes = surface.boxes(c.duration);
  }
  auto& patches = patches_[static_cast<std::size_t>(patched_[index])];
  PatchHit hit =
      patches.query(mesh, c.collider.root, n, pose.to_local(point), gone,
                    gone.knot < 0 ? nullptr : &boxes, contact_distance, !c.collider.container);
  if (c.collider.two_sided) hit.sample = collide::unsided(hit.sample);
  const Vec out = pose.rotated(hit.sample.normal) * side;
  return {{side * hit.sample.distance - contact_distance, out}, hit.triangle};
}

Vec SpringContacts::transported(const StepCollider& c, const PatchHit& hit, bool end,
                                Vec point) const {
  if (c.surface < 0) return c.collider.motion.displacement(point, end ? c.end : c.begin);
  if (hit.triangle < 0) return {};
  const auto& surface = surfaces_[static_cast<std::size_t>(c.surface)];
  return surface.shift(mesh_at(c, end), hit.triangle, point) * c.duration;
}

void SpringContacts::record_impulse(std::size_t c, double mass, Vec point, Vec change) {
  if (c >= colliders_.size() || dot(change, change) == 0) return;
  const Vec impulse = change * -mass, moment = cross(point, impulse);
  double* row = cell_impulses_.data() + IMPULSE_WIDTH * c;
  const double values[IMPULSE_WIDTH - 1] = {impulse.x, impulse.y, impulse.z,
                                            moment.x,  moment.y,  moment.z};
  for (std::size_t k = 0; k < IMPULSE_WIDTH - 1; ++k) row[k] += values[k];
  masses_[c] += mass;
}

bool SpringContacts::resolve_particle(std::size_t n, double mass, double* before, double* x,
                                      double* v) {
  const Vec from = load(before);
  Vec to = load(x), unmoved = from;
  bool moved = false, pushed = true;
  // Solvers without velocities derive them from the displacement of the step.
  auto speed = [&] { return v ? load(v) : (to - unmoved) * (1 / h_); };
  Vec last = speed();
  auto record_change = [&](std::size_t c) {
    const Vec now = speed();
    record_impulse(c, mass, to, now - last);
    last = now;
  };
  for (std::size_t c = 0; c < count_; ++c) {
    moved |= sweep(c, n, from, to, v);
    record_change(c);
  }
  for (int i = 0; i < MAX_ITERATIONS && pushed; ++i) {
    pushed = false;
    nearest_ = collide::FAR;
    for (std::size_t c = 0; c < count_; ++c) {
      pushed |= push(c, n, from, to, unmoved, v);
      record_change(c);
    }
    moved |= pushed;
  }
  if (pushed) nearest_ = clearance(n, to);
  update_clearance(n, to, nearest_);
  if (moved) {
    store(to, x);
    store(unmoved, before);
  }
  return moved;
}

bool SpringContacts::sweep(std::size_t c, std::size_t n, Vec from, Vec& to, double* v) {
  if (step_colliders_[c].is_mesh()) return sweep_mesh(c, n, from, to, v);
  return step_colliders_[c].sweep(h_, colliders_.radius(), from, to, v);
}

bool SpringContacts::sweep_mesh(std::size_t index, std::size_t n, Vec from, Vec& to, double* v) {
  const StepCollider& c = step_colliders_[index];
  const double arm = length(from - c.begin.origin);
  const double displacement = length(to - from) + c.travel({}) + c.rotation() * arm;
  const double radius = colliders_.radius();
  if (!(displacement > c.thickness(radius))) return false;
  const PatchHit hit = query(index, n, false, from);
  // Particles that start inside are moved out at the depenetration speed.
  if (hit.sample.distance > displacement || hit.sample.distance < -collide::INSIDE) return false;
  const Vec gone = transported(c, hit, false, from);
  if (!(length(to - from - gone) > c.thickness(radius))) return false;
  if (c.surface < 0) return c.sweep(h_, radius, from, to, v);
  // In the frame of the nearest triangle; the rest of the mesh is as at the end of the step.
  const Vec start = from + gone, speed = (to - start) * (1 / h_);
  collide::Particle last{to, speed};
  collide::ParticleContacts contacts(&c.collider, 1, h_, radius);
  if (contacts.resolve({start, speed}, last).collider < 0) return false;
  to = last.position;
  if (v) store(last.velocity + gone * (1 / h_), v);
  return true;
}

// A particle that crossed a two-sided surface in a step counts as inside.
void SpringContacts::flip_if_crossed(const StepCollider& c, Vec from, Vec to, Sample& hit) const {
  const double off = collide::contact_distance(c.collider, colliders_.radius());
  const Vec before = c.begin.to_local(from), after = c.end.to_local(to);
  if (hit.distance + off > length(after - before)) return;
  if (!collide::crosses_mesh(c.collider.mesh, c.collider.root, before, after)) return;
  hit = {-(hit.distance + off) - off, -hit.normal};
}

bool SpringContacts::push(std::size_t index, std::size_t n, Vec from, Vec& to, Vec& unmoved,
                          double* v) {
  const StepCollider& c = step_colliders_[index];
  const double allowed = depth(index, n);
  PatchHit view = query(index, n, true, to);
  if (c.collider.two_sided) flip_if_crossed(c, from, to, view.sample);
  const Sample& hit = view.sample;
  nearest_ = std::min(nearest_, hit.distance - allowed);
  if (!(hit.distance < allowed - collide::TOUCH)) return false;
  const Vec shift = transported(c, view, true, to);
  if (v) {
    const Vec surface = shift * (1 / h_), speed = load(v) - surface;
    const double normal_speed = dot(speed, hit.normal);
    if (normal_speed < 0) {
      const double restitution = c.collider.restitution;
      const double friction_speed = c.collider.friction * -normal_speed * (1 + restitution);
      Vec along = speed - hit.normal * normal_speed;
      const double slip_speed = length(along);
      along = along * (slip_speed > friction_speed ? 1 - friction_speed / slip_speed : 0.0);
      // The speed that gravity adds in a step is no impact: the particle rests.
      const double back = -normal_speed > min_impact_speed_ ? restitution * normal_speed : 0.0;
      store(surface + along - hit.normal * back, v);
    }
  }
  const double begun = query(index, n, false, from).sample.distance;
  Rod rod = c.rod;
  if (c.surface >= 0) store(shift, rod.travel);
  return collide::push_out(rod, {hit.distance, hit.normal}, begun, allowed, from, to, unmoved);
}

}  // namespace animtool
