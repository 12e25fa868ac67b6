// Particles of springs against colliders.
#include "springs_contacts.h"

#include <algorithm>
#include <stdexcept>

namespace animtool {

namespace {

using collide::Collider;
using collide::Sample;
using collide::Shape;
using collide::Vec;
using collide::load;
using collide::store;

// Rounds of moving out of all colliders.
constexpr int TRIES = 3;

// A way longer than this may lead through a collider within a step.
double thickness(const Collider& c) {
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

}  // namespace

SpringContacts::SpringContacts(const std::optional<SpringColliders>& colliders,
                               std::size_t particles, std::int64_t cells) {
  if (!colliders) return;
  const auto& [arrays, poses, radius] = *colliders;
  colliders_ = read_colliders(arrays);
  if (poses.shape(0) != static_cast<std::size_t>(cells) ||
      poses.shape(1) != colliders_.size() || poses.shape(2) != 2 || poses.shape(3) != 7)
    throw std::invalid_argument("poses are (cells, C, 2, 7)");
  poses_ = poses.data();
  radius_ = radius;
  clear_.assign(particles, 0.0);
  arm_.assign(particles, 0.0);
}

void SpringContacts::begin_cell(std::int64_t cell, int substeps) {
  if (!any()) return;
  substeps_ = substeps;
  whole_.clear();
  const std::size_t row = 14 * colliders_.size();
  const double* pose = poses_ + static_cast<std::size_t>(cell) * row;
  for (std::size_t c = 0; c < colliders_.size(); ++c)
    whole_.emplace_back(pose + 14 * c, pose + 14 * c + 7);
  // Where a cell is crossed again, or a collider is put elsewhere, nothing is known.
  bool goes_on = cell == last_ + 1;
  for (std::size_t c = 0; c < row && goes_on && last_ >= 0; c += 14)
    goes_on = std::equal(pose + c, pose + c + 7, pose + c + 7 - row);
  if (!goes_on) std::fill(clear_.begin(), clear_.end(), 0.0);
  last_ = cell;
}

bool SpringContacts::settle(const SpringNetwork& network, int step, double h,
                            const std::vector<double>& before, std::vector<double>& x,
                            std::vector<double>* v) {
  if (!any()) return false;
  double travel = 0, angle = 0;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    colliders_[c].motion = whole_[c].part(double(step) / substeps_, double(step + 1) / substeps_);
    travel = std::max(travel, length(colliders_[c].motion.travel()));
    angle = std::max(angle, colliders_[c].motion.angle());
  }
  bool moved = false;
  std::int64_t inside = 0;
  for (std::size_t n = 0; n < network.particles(); ++n) {
    if (network.inverse_masses[n] == 0) continue;
    double *at = x.data() + ROW * n, way = travel + angle * arm_[n];
    const double* from = before.data() + ROW * n;
    for (std::size_t k = 0; k < 3; ++k) way += std::abs(at[k] - from[k]);
    clear_[n] -= way;
    if (clear_[n] > 0) continue;
    bool left_inside = false;
    moved |= settle_one(1 / h, h, from, at, v ? v->data() + ROW * n : nullptr, left_inside);
    inside += left_inside;
    measure(n, at);
  }
  if (step + 1 == substeps_) unresolved = std::max(unresolved, inside);
  return moved;
}

void SpringContacts::measure(std::size_t n, const double* x) {
  double clear = collide::FAR, arm = 0;
  for (const Collider& c : colliders_) {
    const collide::Pose pose = c.motion.at(1);
    const double near = sample(c, pose, load(x), radius_, collide::FAR).distance;
    clear = std::min(clear, near);
    arm = std::max(arm, length(load(x) - pose.origin));
  }
  clear_[n] = std::max(clear, 0.0);
  arm_[n] = arm + 2 * clear_[n];
}

bool SpringContacts::settle_one(double inverse_h, double h, const double* before, double* x,
                                double* v, bool& left_inside) {
  const Vec from = load(before);
  Vec to = load(x);
  bool moved = false;
  for (const Collider& c : colliders_) {
    if (!(length(to - from) > thickness(c))) continue;
    const Vec speed = (to - from) * inverse_h;
    collide::Particle end{to, speed};
    if (collide::Settling(&c, 1, h, radius_).settle({from, speed}, end).collider < 0) continue;
    to = end.position;
    if (v) store(end.velocity, v);
    moved = true;
  }
  for (int i = 0; i < TRIES; ++i) {
    bool pushed = false;
    left_inside = false;
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      pushed |= push(c, h, from, to, v, left_inside);
    moved |= pushed;
    if (!pushed) break;
  }
  for (const Collider& c : colliders_)
    left_inside |= sample(c, c.motion.at(1), to, radius_, collide::FAR).distance <
                   -collide::INSIDE;
  if (moved) store(to, x);
  return moved;
}

bool SpringContacts::push(std::size_t index, double h, Vec from, Vec& to, double* v,
                          bool& left_inside) {
  const Collider& c = colliders_[index];
  const collide::Pose end = c.motion.at(1);
  const Sample found = sample(c, end, to, radius_, collide::FAR);
  if (!(found.distance < -collide::TOUCH)) return false;
  const double start = sample(c, c.motion.at(0), from, radius_, collide::FAR).distance;
  // What began inside is moved out no faster than it may.
  const double goal =
      start < -collide::INSIDE ? std::min(start + c.depenetration * h, 0.0) : 0.0;
  left_inside |= goal < 0;
  const double out = goal - found.distance;
  const Vec carried = c.motion.displacement(to, end);
  if (v) {
    const Vec surface = carried * (1 / h), speed = load(v) - surface;
    const double into = dot(speed, found.normal);
    if (into < 0) {
      Vec along = speed - found.normal * into;
      const double pressed = -into * (1 + c.restitution), most = length(along);
      along = along * (most > c.friction * pressed ? 1 - c.friction * pressed / most : 0.0);
      store(surface + along - found.normal * (c.restitution * into), v);
    }
  }
  if (!(out > 0)) return false;
  to = to + found.normal * out;
  const Vec way = to - from - carried;
  const Vec along = way - found.normal * dot(way, found.normal);
  const double most = length(along), held = c.friction * out;
  if (most > 0) to = to - along * (most > held ? held / most : 1.0);
  return true;
}

}  // namespace animtool
