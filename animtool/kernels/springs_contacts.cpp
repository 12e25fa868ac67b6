// Particles of springs against colliders.
#include "springs_contacts.h"

#include <algorithm>
#include <stdexcept>

namespace animtool {

namespace {

using collide::Collider;
using collide::Motion;
using collide::Pose;
using collide::Rod;
using collide::Sample;
using collide::Shape;
using collide::Vec;
using collide::load;
using collide::store;

// Steps of weight whose speed into a surface is taken for resting on it.
constexpr double RESTING = 2;
// Rounds of moving out of all colliders.
constexpr int TRIES = 3;

// One particle by itself, for what is written for several.
struct OneRow {
  using Row = double;

  static double spread(double value) { return value; }
  static double add(double a, double b) { return a + b; }
  static double subtract(double a, double b) { return a - b; }
  static double multiply(double a, double b) { return a * b; }
  static double divide(double a, double b) { return a / b; }
  static double inverse(double a) { return a > 0 ? 1 / a : 0; }
  static double root(double a) { return std::sqrt(a); }
  static double least(double a, double b) { return a < b ? a : b; }
  static double most(double a, double b) { return a > b ? a : b; }
  static double below(double a, double b) { return a < b; }
  static double chosen(double where, double a, double b) { return where != 0 ? a : b; }
  static double either(double a, double b) { return a != 0 || b != 0; }
  static unsigned bits(double where) { return where != 0; }
};

using One = Wide<OneRow>;
using OneVec = WideVec<OneRow>;

OneVec one(Vec a) { return {a.x, a.y, a.z}; }
Vec vec(const OneVec& a) { return {a.x.row, a.y.row, a.z.row}; }

double thickness_of(const Collider& c) {
  if (c.container) return collide::FAR;
  switch (c.shape) {
    case Shape::PLANE: return collide::FAR;
    case Shape::SPHERE: return c.size[3];
    case Shape::CAPSULE: return c.size[6];
    case Shape::BOX: return std::min({c.size[0], c.size[1], c.size[2]});
    case Shape::MESH: return c.margin;
  }
  return 0;
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
  const auto found = collide::sample_rod<OneRow>(axis, c.rod.radius, one(point));
  return {found.distance.row, vec(found.normal)};
}

}  // namespace

Sample StepCollider::before(Vec point, double radius) const {
  return sampled(*this, rod.begin, begin, point, radius);
}

Sample StepCollider::after(Vec point, double radius) const {
  return sampled(*this, rod.end, end, point, radius);
}

double StepCollider::travel(Vec drift) const {
  if (!is_rod) return length(collider.motion.travel() - drift);
  // The axis goes no farther than its ends.
  const Vec first = load(rod.end.from) - load(rod.begin.from) - drift;
  const Vec last = first + (load(rod.end.along) - load(rod.begin.along));
  return std::max(length(first), length(last));
}

double StepCollider::thickness() const { return thickness_of(collider); }

bool StepCollider::sweep(double h, double radius, Vec from, Vec& to, double* v) const {
  if (!(length(to - from) > thickness())) return false;
  // What begins inside comes out at its own pace.
  if (before(from, radius).distance < -collide::INSIDE) return false;
  const Vec speed = (to - from) * (1 / h);
  collide::Particle last{to, speed};
  collide::Settling settling(&collider, 1, h, radius);
  if (settling.settle({from, speed}, last).collider < 0) return false;
  to = last.position;
  if (v) store(last.velocity, v);
  return true;
}

MovingColliders::MovingColliders(const std::optional<SpringColliders>& colliders,
                                 std::size_t particles, std::int64_t cells)
    : particles_(particles) {
  if (!colliders) return;
  const auto& [arrays, poses, radius, depths, tolerance] = *colliders;
  colliders_ = read_colliders(arrays);
  if (poses.shape(0) != static_cast<std::size_t>(cells) ||
      poses.shape(1) != colliders_.size() || poses.shape(2) != 2 || poses.shape(3) != 7)
    throw std::invalid_argument("poses are (cells, C, 2, 7)");
  if (depths && (depths->shape(0) != colliders_.size() || depths->shape(1) != particles))
    throw std::invalid_argument("depths are (C, N)");
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
  std::vector<Motion> whole;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    const double* pose = poses(cell) + 14 * c;
    whole.emplace_back(pose, pose + 7);
  }
  for (int step = 0; step < substeps; ++step)
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      out.push_back(over(colliders_[c],
                         whole[c].part(double(step) / substeps, double(step + 1) / substeps),
                         h));
}

StepCollider MovingColliders::over(const Collider& c, const Motion& motion, double h) const {
  StepCollider made{};
  made.collider = c;
  made.collider.motion = motion;
  made.begin = motion.at(0);
  made.end = motion.at(1);
  made.is_rod = !c.container && (c.shape == Shape::CAPSULE || c.shape == Shape::SPHERE);
  Rod& rod = made.rod;
  store(motion.travel(), rod.travel);
  store(motion.turn(), rod.turn);
  store(made.end.origin, rod.origin);
  rod.friction = c.friction;
  rod.rise = c.depenetration * h;
  if (!made.is_rod) return made;
  const bool ball = c.shape == Shape::SPHERE;
  const Vec a = load(c.size), b = ball ? a : load(c.size + 3);
  const Vec a0 = made.begin.to_world(a), b0 = made.begin.to_world(b);
  const Vec a1 = made.end.to_world(a), b1 = made.end.to_world(b);
  rod.begin = axis_between(a0, b0);
  rod.end = axis_between(a1, b1);
  rod.radius = c.size[ball ? 3 : 6] + c.margin + radius_;
  return made;
}

SpringContacts::SpringContacts(const std::optional<SpringColliders>& colliders,
                               std::size_t particles, std::int64_t cells)
    : colliders_(colliders, particles, cells), cells_(cells) {
  if (!any()) return;
  clear_.assign(particles, 0.0);
  arm_.assign(particles, 0.0);
}

void SpringContacts::begin_cell(std::int64_t cell, int substeps, double h) {
  if (!any()) return;
  substeps_ = substeps;
  h_ = h;
  cell_.clear();
  colliders_.steps(cell, substeps, h, cell_);
  // Where a cell is crossed again, or a collider is put elsewhere, nothing is known.
  const bool known = cell == last_ + 1 && (last_ < 0 || colliders_.goes_on(cell));
  if (!known) std::fill(clear_.begin(), clear_.end(), 0.0);
  last_ = cell;
}

bool SpringContacts::settle(const SpringNetwork& network, int step,
                            std::vector<double>& before, std::vector<double>& x,
                            std::vector<double>* v) {
  if (!any()) return false;
  now_ = cell_.data() + static_cast<std::size_t>(step) * colliders_.size();
  double travel = 0, angle = 0;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    travel = std::max(travel, now_[c].travel({}));
    angle = std::max(angle, now_[c].turn());
  }
  least_blow_ = RESTING * h_ * std::sqrt(dot3(network.gravity, network.gravity));
  std::int64_t moved = 0, inside = 0;
  for (std::size_t n = 0; n < network.particles(); ++n) {
    if (network.inverse_masses[n] == 0) continue;
    double *at = x.data() + ROW * n, way = travel + angle * arm_[n];
    double* from = before.data() + ROW * n;
    for (std::size_t k = 0; k < 3; ++k) way += std::abs(at[k] - from[k]);
    clear_[n] -= way;
    if (clear_[n] > 0) continue;
    moved += settle_one(n, from, at, v ? v->data() + ROW * n : nullptr);
    inside += measure(n, at);
  }
  touched = std::max(touched, moved);
  if (last_ + 1 == cells_ && step + 1 == substeps_) unresolved = inside;
  return moved > 0;
}

bool SpringContacts::measure(std::size_t n, const double* x) {
  double clear = collide::FAR, arm = 0;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    const double near = now_[c].after(load(x), colliders_.radius()).distance;
    clear = std::min(clear, near - colliders_.depth(c, n));
    arm = std::max(arm, length(load(x) - now_[c].end.origin));
  }
  clear_[n] = std::max(clear, 0.0);
  arm_[n] = arm + 2 * clear_[n];
  return clear < -colliders_.tolerance();
}

bool SpringContacts::settle_one(std::size_t n, double* before, double* x, double* v) {
  const Vec from = load(before);
  Vec to = load(x), still = from;
  bool moved = false;
  for (std::size_t c = 0; c < colliders_.size(); ++c)
    moved |= now_[c].sweep(h_, colliders_.radius(), from, to, v);
  for (int i = 0; i < TRIES; ++i) {
    bool pushed = false;
    for (std::size_t c = 0; c < colliders_.size(); ++c) pushed |= push(c, n, from, to, still, v);
    moved |= pushed;
    if (!pushed) break;
  }
  if (moved) {
    store(to, x);
    store(still, before);
  }
  return moved;
}

bool SpringContacts::push(std::size_t index, std::size_t n, Vec from, Vec& to,
                          Vec& still, double* v) {
  const StepCollider& c = now_[index];
  const double depth = colliders_.depth(index, n);
  const Sample found = c.after(to, colliders_.radius());
  if (!(found.distance < depth - collide::TOUCH)) return false;
  if (v) {
    const Motion& motion = c.collider.motion;
    const Vec surface = motion.displacement(to, c.end) * (1 / h_), speed = load(v) - surface;
    const double into = dot(speed, found.normal);
    if (into < 0) {
      const double restitution = c.collider.restitution;
      const double held = c.collider.friction * -into * (1 + restitution);
      Vec along = speed - found.normal * into;
      const double most = length(along);
      along = along * (most > held ? 1 - held / most : 0.0);
      // What a step of its weight brings is no blow: it rests.
      const double back = -into > least_blow_ ? restitution * into : 0.0;
      store(surface + along - found.normal * back, v);
    }
  }
  const double begun = c.before(from, colliders_.radius()).distance;
  OneVec place = one(to), stood = one(still);
  const bool out = collide::push_out<OneRow>(c.rod, {found.distance, one(found.normal)}, begun,
                                             depth, one(from), place, stood);
  to = vec(place);
  still = vec(stood);
  return out;
}

}  // namespace animtool
