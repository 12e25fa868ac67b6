// Particles of springs against colliders.
#include "springs/contacts.h"

#include <algorithm>

#include "base/checks.h"

namespace animtool {

namespace {

using collide::Collider;
using collide::Mesh;
using collide::Motion;
using collide::Pose;
using collide::Rod;
using collide::Sample;
using collide::Shape;
using collide::Vec;
using collide::load;
using collide::store;

// Impact speed, in steps of gravity, below which a contact is resting.
constexpr double RESTING = 2;
// Iterations over all colliders.
constexpr int TRIES = 3;
// Impulse, moment, mass.
constexpr std::size_t PUSH = 7;
// Factor of the radius for edge midpoints, which cut corners.
constexpr double MIDDLES_NEARER = 0.25;
// Of the size of a mesh, how far what is near a particle serves at first.
constexpr double FINE = 1e-3;
// Of that, where patches begin: what is near on a fine mesh is more than one holds.
constexpr double FIRST_SLACK = 0.25;

double thickness_of(const Collider& c, double radius) {
  if (c.container) return collide::FAR;
  switch (c.shape) {
    case Shape::PLANE: return collide::FAR;
    case Shape::SPHERE: return c.size[3];
    case Shape::CAPSULE: return c.size[6];
    case Shape::BOX: return std::min({c.size[0], c.size[1], c.size[2]});
    // Up to there a particle comes to no more than its surface.
    case Shape::MESH: return collide::contact_distance(c, radius);
  }
  return 0;
}

// Adds the impulses of two spans of time.
std::vector<double> both(const std::vector<double>& first, const std::vector<double>& second) {
  std::vector<double> sum(first);
  for (std::size_t k = 0; k < sum.size(); ++k)
    sum[k] = k % PUSH == PUSH - 1 ? std::max(sum[k], second[k]) : sum[k] + second[k];
  return sum;
}

Rod::Axis axis_between(Vec a, Vec b) {
  Rod::Axis axis;
  const Vec along = b - a;
  const double squared = dot(along, along);
  store(a, axis.from);
  store(along, axis.along);
  axis.inverse = squared > 0 ? 1 / squared : 0;
  const Vec out =
      squared > 0 ? collide::across(along * (1 / std::sqrt(squared))) : Vec{0, 1, 0};
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
    begun_mesh.mesh.fraction = begun;
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

double StepCollider::thickness(double radius) const {
  return thickness_of(collider, radius);
}

bool StepCollider::sweep(double h, double radius, Vec from, Vec& to, double* v) const {
  // A moving mesh is tested at the end of the step, in a frame that moves with it.
  const Vec transported = surface >= 0 ? load(rod.travel) : Vec{}, start = from + transported;
  if (!(length(to - start) > thickness(radius))) return false;
  // Particles that start inside are moved out at the depenetration speed.
  if (before(from, radius).distance < -collide::INSIDE) return false;
  const Vec speed = (to - start) * (1 / h);
  collide::Particle last{to, speed};
  collide::ParticleContacts settling(&collider, 1, h, radius);
  if (settling.resolve({start, speed}, last).collider < 0) return false;
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
  check::numbers("colliders.poses", poses, {static_cast<std::size_t>(cells), colliders_.size(), 2, 7});
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

bool MovingColliders::goes_on(std::int64_t cell) const {
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
      out.push_back(over(colliders_[c],
                         full[c].part(double(step) / substeps, double(step + 1) / substeps),
                         h));
}

StepCollider MovingColliders::over(const Collider& c, const Motion& motion, double h) const {
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
  rod.rise = c.depenetration * h;
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
                               const SpringNetwork& network, std::int64_t cells,
                               bool middles)
    : network_(network),
      colliders_(colliders, network.particles(), cells),
      faces_(network, colliders_.radius()),
      count_(colliders_.size()),
      cells_(cells),
      middles_(middles) {
  if (!colliders) return;
  const std::size_t particles = network.particles() + (middles ? network.edges.size() / 2 : 0);
  for (std::size_t c = 0; c < count_; ++c) faces_.add(colliders_[c]);
  for (const SpringSurface& one : std::get<5>(*colliders)) surfaces_.emplace_back(one, cells);
  count_ += surfaces_.size();
  make_patches(particles);
  pushed_.assign(PUSH * colliders_.size(), 0.0);
  pushing_ = pushed_;
  clear_.assign(particles, 0.0);
  arm_.assign(particles, 0.0);
}

void SpringContacts::make_patches(std::size_t particles) {
  for (std::size_t c = 0; c < count_; ++c) {
    const bool rigid = c < colliders_.size();
    const double margin =
        rigid ? colliders_[c].margin : surfaces_[c - colliders_.size()].margin();
    const double kept = colliders_.radius() + (rigid ? margin : 0);
    kept_.push_back(colliders_.radius() + margin);
    const double* box = nullptr;
    if (!rigid)
      box = surfaces_[c - colliders_.size()].box();
    else if (colliders_[c].shape == Shape::MESH)
      box = colliders_[c].mesh.bounds + 6 * colliders_[c].root;
    patched_.push_back(box ? static_cast<std::int32_t>(patches_.size()) : -1);
    if (box)
      patches_.emplace_back(
          particles, FIRST_SLACK * std::max(kept, FINE * length(load(box + 3) - load(box))));
  }
}

void SpringContacts::begin_cell(std::int64_t cell, int substeps, double h) {
  if (!any()) return;
  substeps_ = substeps;
  h_ = h;
  if (cell != last_) pushed_ = both(pushed_, pushing_);
  std::fill(pushing_.begin(), pushing_.end(), 0.0);
  rigid_.clear();
  colliders_.steps(cell, substeps, h, rigid_);
  // A teleported collider invalidates the cache.
  const bool again = cell == last_;
  bool known = again || (cell == last_ + 1 && (last_ < 0 || colliders_.goes_on(cell)));
  enter_surfaces(cell, known);
  add_surfaces();
  if (again) clear_ = begun_clear_, arm_ = begun_arm_;
  if (!known) std::fill(clear_.begin(), clear_.end(), 0.0);
  begun_clear_ = clear_, begun_arm_ = arm_;
  last_ = cell;
}

void SpringContacts::enter_surfaces(std::int64_t cell, bool& known) {
  for (std::size_t s = 0; s < surfaces_.size(); ++s) {
    if (surfaces_[s].enter(cell, h_ * substeps_)) continue;
    known = false;
    patches_[static_cast<std::size_t>(patched_[colliders_.size() + s])].forget();
  }
}

void SpringContacts::add_surfaces() {
  cell_.clear();
  for (int step = 0; step < substeps_; ++step) {
    const auto first = rigid_.begin() + step * static_cast<std::ptrdiff_t>(colliders_.size());
    cell_.insert(cell_.end(), first, first + static_cast<std::ptrdiff_t>(colliders_.size()));
    for (std::size_t s = 0; s < surfaces_.size(); ++s) {
      StepCollider built{};
      const double begun = surfaces_[s].gone(double(step) / substeps_);
      const double ended = surfaces_[s].gone(double(step + 1) / substeps_);
      built.collider = surfaces_[s].collider(ended);
      built.surface = static_cast<std::int32_t>(s);
      built.begun = begun;
      built.lasts = ended - begun;
      built.shift = surfaces_[s].travel() * built.lasts;
      built.rod.friction = built.collider.friction;
      built.rod.rise = built.collider.depenetration * h_;
      cell_.push_back(built);
    }
  }
}

Out<double, 2> SpringContacts::pushes() const {
  const std::vector<double> sum = both(pushed_, pushing_);
  Out<double, 2> rows(sum.size() / PUSH, PUSH);
  std::copy(sum.begin(), sum.end(), rows.get());
  return rows;
}

bool SpringContacts::settle(int step, std::vector<double>& before, std::vector<double>& x,
                            std::vector<double>* v, std::vector<std::uint8_t>* marks) {
  if (!any()) return false;
  now_ = cell_.data() + static_cast<std::size_t>(step) * count_;
  double travel = 0, angle = 0;
  for (std::size_t c = 0; c < count_; ++c) {
    travel = std::max(travel, now_[c].travel({}));
    angle = std::max(angle, now_[c].rotation());
  }
  masses_.assign(colliders_.size(), 0.0);
  least_blow_ = RESTING * h_ * std::sqrt(dot3(network_.gravity, network_.gravity));
  std::int64_t moved = 0, inside = 0;
  const double reach = faces_.reach();
  near_.clear();
  for (std::size_t n = 0; n < network_.particles(); ++n) {
    if (network_.inverse_masses[n] == 0) {
      if (faces_.any()) near_.push_back(static_cast<std::int32_t>(n));
      continue;
    }
    if (marks && !(*marks)[n]) continue;
    double *at = x.data() + ROW * n, shift = travel + angle * arm_[n];
    double* from = before.data() + ROW * n;
    for (std::size_t k = 0; k < 3; ++k) shift += std::abs(at[k] - from[k]);
    clear_[n] -= shift;
    if (clear_[n] <= reach) near_.push_back(static_cast<std::int32_t>(n));
    if (clear_[n] > 0) continue;
    const double mass = 1 / network_.inverse_masses[n];
    moved += settle_one(n, mass, from, at, v ? v->data() + ROW * n : nullptr);
    inside += nearest_ < -colliders_.tolerance();
  }
  for (std::size_t c = 0; c < masses_.size(); ++c) {
    double& most = pushing_[PUSH * c + PUSH - 1];
    most = std::max(most, masses_[c]);
  }
  if (middles_) settle_middles(travel, angle, {before, x, v}, marks);
  touched = std::max(touched, moved);
  if (!marks && last_ + 1 == cells_ && step + 1 == substeps_) unresolved = inside;
  const bool faces = !near_.empty() && settle_faces({before, x, v});
  if (faces && marks)
    for (const std::int32_t n : near_) (*marks)[static_cast<std::size_t>(n)] = 1;
  return moved > 0 || faces;
}

void SpringContacts::settle_middles(double travel, double angle, StepRows rows,
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
    double to[3], from[3], shift = travel + angle * arm_[particles + e];
    for (std::size_t k = 0; k < 3; ++k) {
      to[k] = (p[k] + q[k]) / 2, from[k] = (was[k] + stood[k]) / 2;
      shift += std::abs(to[k] - from[k]);
    }
    clear_[particles + e] -= shift;
    if (clear_[particles + e] > 0) continue;
    const Vec ended = load(to), begun = load(from);
    if (!settle_one(particles + e, 4 / (i + j), from, to, nullptr)) continue;
    if (marks) (*marks)[first] = (*marks)[last] = 1;
    const Vec by = (load(to) - ended) * (2 / (i + j));
    const Vec back = (load(from) - begun) * (2 / (i + j));
    clear_[first] -= i * length(by), clear_[last] -= j * length(by);
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
  return least - kept_[c] * MIDDLES_NEARER;
}

bool SpringContacts::settle_faces(StepRows rows) {
  bool moved = false;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    if (!faces_.settle(c, now_[c], h_, near_, rows)) continue;
    moved = true;
    for (const FaceContacts::Moved& one : faces_.moved) {
      const auto n = static_cast<std::size_t>(one.particle);
      clear_[n] -= one.shift;
      note_push(c, 1 / network_.inverse_masses[n], load(&rows.x[ROW * n]), one.change);
    }
  }
  return moved;
}

double SpringContacts::clearance(std::size_t n, Vec x) {
  double clear = collide::FAR;
  for (std::size_t c = 0; c < count_; ++c)
    clear = std::min(clear, look(c, n, true, x).sample.distance - depth(c, n));
  return clear;
}

void SpringContacts::note(std::size_t n, Vec x, double clear) {
  double arm = 0;
  for (std::size_t c = 0; c < count_; ++c) arm = std::max(arm, length(x - now_[c].end.origin));
  clear_[n] = std::max(clear, 0.0);
  arm_[n] = arm + 2 * clear_[n];
}

Mesh SpringContacts::mesh_at(const StepCollider& c, bool end) const {
  Mesh mesh = c.collider.mesh;
  if (!end) mesh.fraction = c.begun;
  return mesh;
}

SpringContacts::PatchHit SpringContacts::look(std::size_t index, std::size_t n, bool end,
                                           Vec point) {
  const StepCollider& c = now_[index];
  const double radius = colliders_.radius();
  if (!c.is_mesh()) return {end ? c.after(point, radius) : c.before(point, radius), -1};
  const Mesh mesh = mesh_at(c, end);
  const Pose& pose = end ? c.end : c.begin;
  const double kept = collide::contact_distance(c.collider, radius), side = c.collider.container ? -1 : 1;
  MeshShift gone;
  KnotBoxes boxes{};
  if (c.surface >= 0) {
    const auto& surface = surfaces_[static_cast<std::size_t>(c.surface)];
    gone = surface.shift_until(mesh.fraction);
    boxes = surface.boxes(c.lasts);
  }
  auto& patches = patches_[static_cast<std::size_t>(patched_[index])];
  PatchHit hit = patches.look(mesh, c.collider.root, n, pose.to_local(point), gone,
                             gone.knot < 0 ? nullptr : &boxes, kept, !c.collider.container);
  if (c.collider.two_sided) hit.sample = collide::unsided(hit.sample);
  const Vec out = pose.rotated(hit.sample.normal) * side;
  return {{side * hit.sample.distance - kept, out}, hit.triangle};
}

Vec SpringContacts::transported(const StepCollider& c, const PatchHit& hit, bool end,
                            Vec point) const {
  if (c.surface < 0)
    return c.collider.motion.displacement(point, end ? c.end : c.begin);
  if (hit.triangle < 0) return {};
  const auto& surface = surfaces_[static_cast<std::size_t>(c.surface)];
  return surface.shift(mesh_at(c, end), hit.triangle, point) * c.lasts;
}

void SpringContacts::note_push(std::size_t c, double mass, Vec point, Vec change) {
  if (c >= colliders_.size() || dot(change, change) == 0) return;
  const Vec impulse = change * -mass, moment = cross(point, impulse);
  double* row = pushing_.data() + PUSH * c;
  const double values[PUSH - 1] = {impulse.x, impulse.y, impulse.z,
                                   moment.x,  moment.y,  moment.z};
  for (std::size_t k = 0; k < PUSH - 1; ++k) row[k] += values[k];
  masses_[c] += mass;
}

bool SpringContacts::settle_one(std::size_t n, double mass, double* before, double* x,
                                double* v) {
  const Vec from = load(before);
  Vec to = load(x), unmoved = from;
  bool moved = false, pushed = true;
  // Solvers without velocities derive them from the displacement of the step.
  auto speed = [&] { return v ? load(v) : (to - unmoved) * (1 / h_); };
  Vec last = speed();
  auto note_change = [&](std::size_t c) {
    const Vec now = speed();
    note_push(c, mass, to, now - last);
    last = now;
  };
  for (std::size_t c = 0; c < count_; ++c) {
    moved |= sweep(c, n, from, to, v);
    note_change(c);
  }
  for (int i = 0; i < TRIES && pushed; ++i) {
    pushed = false;
    nearest_ = collide::FAR;
    for (std::size_t c = 0; c < count_; ++c) {
      pushed |= push(c, n, from, to, unmoved, v);
      note_change(c);
    }
    moved |= pushed;
  }
  if (pushed) nearest_ = clearance(n, to);
  note(n, to, nearest_);
  if (moved) {
    store(to, x);
    store(unmoved, before);
  }
  return moved;
}

bool SpringContacts::sweep(std::size_t c, std::size_t n, Vec from, Vec& to, double* v) {
  if (now_[c].is_mesh()) return sweep_mesh(c, n, from, to, v);
  return now_[c].sweep(h_, colliders_.radius(), from, to, v);
}

bool SpringContacts::sweep_mesh(std::size_t index, std::size_t n, Vec from, Vec& to,
                                double* v) {
  const StepCollider& c = now_[index];
  const double arm = length(from - c.begin.origin);
  const double most = length(to - from) + c.travel({}) + c.rotation() * arm;
  const double radius = colliders_.radius();
  if (!(most > c.thickness(radius))) return false;
  const PatchHit hit = look(index, n, false, from);
  // Particles that start inside are moved out at the depenetration speed.
  if (hit.sample.distance > most || hit.sample.distance < -collide::INSIDE) return false;
  const Vec gone = transported(c, hit, false, from);
  if (!(length(to - from - gone) > c.thickness(radius))) return false;
  if (c.surface < 0) return c.sweep(h_, radius, from, to, v);
  // It is seen from what of the surface is nearest: the rest of that stands as at the end.
  const Vec start = from + gone, speed = (to - start) * (1 / h_);
  collide::Particle last{to, speed};
  collide::ParticleContacts settling(&c.collider, 1, h_, radius);
  if (settling.resolve({start, speed}, last).collider < 0) return false;
  to = last.position;
  if (v) store(last.velocity + gone * (1 / h_), v);
  return true;
}

// A particle that crossed a two-sided surface in a step counts as inside.
void SpringContacts::push_back_out(const StepCollider& c, Vec from, Vec to, Sample& hit) const {
  const double off = collide::contact_distance(c.collider, colliders_.radius());
  const Vec before = c.begin.to_local(from), after = c.end.to_local(to);
  if (hit.distance + off > length(after - before)) return;
  if (!collide::crosses_mesh(c.collider.mesh, c.collider.root, before, after)) return;
  hit = {-(hit.distance + off) - off, -hit.normal};
}

bool SpringContacts::push(std::size_t index, std::size_t n, Vec from, Vec& to,
                          Vec& unmoved, double* v) {
  const StepCollider& c = now_[index];
  const double allowed = depth(index, n);
  PatchHit view = look(index, n, true, to);
  if (c.collider.two_sided) push_back_out(c, from, to, view.sample);
  const Sample& hit = view.sample;
  nearest_ = std::min(nearest_, hit.distance - allowed);
  if (!(hit.distance < allowed - collide::TOUCH)) return false;
  const Vec shift = transported(c, view, true, to);
  if (v) {
    const Vec surface = shift * (1 / h_), speed = load(v) - surface;
    const double into = dot(speed, hit.normal);
    if (into < 0) {
      const double restitution = c.collider.restitution;
      const double pinned = c.collider.friction * -into * (1 + restitution);
      Vec along = speed - hit.normal * into;
      const double most = length(along);
      along = along * (most > pinned ? 1 - pinned / most : 0.0);
      // The speed that gravity adds in a step is no impact: the particle rests.
      const double back = -into > least_blow_ ? restitution * into : 0.0;
      store(surface + along - hit.normal * back, v);
    }
  }
  const double begun = look(index, n, false, from).sample.distance;
  Rod rod = c.rod;
  if (c.surface >= 0) store(shift, rod.travel);
  return collide::push_out(rod, {hit.distance, hit.normal}, begun, allowed, from, to, unmoved);
}

}  // namespace animtool
