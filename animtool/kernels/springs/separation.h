// Separation of two parts of a surface in self-contact.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "springs/pairs.h"

namespace animtool {

// No particle moves by more than this many times the separation: a single free particle with a
// small weight would be thrown away.
constexpr double MAX_RATIO = 10;
// Smallest effective weight, over the largest inverse mass: with less, particles move less.
constexpr double MIN_WEIGHT = 1e-3;
// Missing fraction of the contact distance below which two elements count as separated.
constexpr double TOLERANCE = 1e-2;

// Two nearby elements, and the side from which the first pierced the second (1 or -1), 0 if it did
// not.
struct LayerHit {
  std::int32_t first, second, side;
  FourParticles who;
  double gap, travel, distance;
};

// Separation in one step. Momentum is conserved. If elements only return to the contact distance,
// the previous positions move too, so that no velocity is added.
class Separation {
 public:
  // `return_shift` is the largest separation in the step without added speed. With `at_ends`,
  // piercing edges are separated even if they are closest at an end.
  Separation(double friction, double return_shift, const std::vector<double>& inverse_masses,
             std::vector<double>& before, std::vector<double>& x, bool at_ends = false)
      : friction_(friction),
        max_return_(return_shift),
        inverse_masses_(inverse_masses),
        before_(before),
        x_(x),
        at_ends_(at_ends) {}

  // Separates two elements; returns whether they were too close.
  template <class Shape>
  bool separate(const LayerHit& hit);
  // Ends the step.
  void end() {
    if (shifts_) before_ = std::move(shifted_);
  }

 private:
  // Moves four particles by their weights: `contact_shift` with friction, `return_shift` without
  // adding speed.
  void move(const LayerHit& hit, const double* fraction, collide::Vec out, double contact_shift,
            double return_shift);

  double friction_, max_return_;
  const std::vector<double>& inverse_masses_;
  std::vector<double>&before_, &x_;
  bool at_ends_;
  std::vector<double> shifted_;  // previous positions, shifted so that no speed is added
  bool shifts_ = false;
};

template <class Shape>
bool Separation::separate(const LayerHit& hit) {
  const Shape now(hit.who.data(), x_.data());
  const shapes::Nearest near = now.nearest();
  if (!near.inside && !(at_ends_ && hit.side)) return false;
  double gap = length(near.off);
  const double height = hit.side ? hit.side * now.height() : gap;
  if (!(std::min(height, gap) < hit.distance)) return false;
  const bool through = height < 0;
  collide::Vec out = near.off * (1 / gap);
  if (through || !(gap > 0)) out = collide::direction(now.normal(), {0, 0, 1});
  if (through) out = out * hit.side, gap = height;
  const auto distance = [&](const std::vector<double>& rows) {
    const Shape was(hit.who.data(), rows.data());
    return through ? hit.side * was.height() : length(was.nearest().off);
  };
  const double first = distance(before_);
  const double goal = std::min(hit.distance, first + max_return_);
  const double begun = std::min(hit.distance, shifts_ ? distance(shifted_) : first);
  const double contact_shift = std::max(0.0, begun - gap);
  const double return_shift = std::max(0.0, goal - std::max(gap, begun));
  move(hit, near.fraction, out, contact_shift, return_shift);
  return contact_shift + return_shift > hit.distance * TOLERANCE;
}

inline void Separation::move(const LayerHit& hit, const double* fraction, collide::Vec out,
                             double contact_shift, double return_shift) {
  if (return_shift > 0 && !shifts_) shifted_ = before_, shifts_ = true;
  std::vector<double>& was = shifts_ ? shifted_ : before_;
  double weights[4], full = 0, farthest = 0, lightest = 0;
  double *to[4], *from[4];
  collide::Vec along;
  for (std::size_t k = 0; k < 4; ++k) {
    const auto particle = static_cast<std::size_t>(hit.who[k]);
    to[k] = &x_[ROW * particle], from[k] = &was[ROW * particle];
    weights[k] = inverse_masses_[particle] * fraction[k];
    full += weights[k] * fraction[k];
    farthest = std::max(farthest, std::abs(weights[k]));
    lightest = std::max(lightest, inverse_masses_[particle]);
    along = along + (collide::load(to[k]) - collide::load(from[k])) * fraction[k];
  }
  full = std::max({full, farthest / MAX_RATIO, lightest * MIN_WEIGHT});
  if (!(full > 0)) return;
  along = along - out * dot(along, out);
  const double slip = length(along), friction_limit = friction_ * contact_shift;
  const double stop = slip > friction_limit ? friction_limit / slip : 1;
  const collide::Vec back_by = out * (return_shift / full);
  const collide::Vec by = out * (contact_shift / full) - along * (stop / full) + back_by;
  for (std::size_t k = 0; k < 4; ++k) {
    collide::store(collide::load(to[k]) + by * weights[k], to[k]);
    if (return_shift > 0) collide::store(collide::load(from[k]) + back_by * weights[k], from[k]);
  }
}

}  // namespace animtool
