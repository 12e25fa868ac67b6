// Separation of two elements of a surface in self-contact.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "springs/pairs.h"

namespace animtool {

// No particle moves by more than this many times the separation. Without this limit, a single free
// particle with a small weight would be thrown far away.
constexpr double MAX_SHIFT_RATIO = 10;
// Smallest effective weight, over the largest inverse mass; limits how far particles move.
constexpr double MIN_EFFECTIVE_WEIGHT = 1e-3;
// Elements count as separated if less than this fraction of the contact distance is missing.
constexpr double SEPARATION_TOLERANCE = 1e-2;

// Two nearby elements, the side from which the first passed through the second (1 or -1, 0 if it
// did not), their particles, their gap, their relative displacement in the step, and their contact
// distance.
struct LayerHit {
  std::int32_t first, second, side;
  FourParticles particles;
  double gap, relative_travel, distance;
};

// Separates elements in one step. Momentum is conserved. If elements only return to the contact
// distance, the previous positions move too, so that no velocity is added.
class Separation {
 public:
  // `return_shift` is the largest separation in the step that adds no velocity. With
  // `separates_at_ends`, intersecting edges are separated even if they are closest at an end.
  Separation(double friction, double return_shift, const std::vector<double>& inverse_masses,
             std::vector<double>& before, std::vector<double>& x, bool separates_at_ends = false)
      : friction_(friction),
        max_return_(return_shift),
        inverse_masses_(inverse_masses),
        before_(before),
        x_(x),
        separates_at_ends_(separates_at_ends) {}

  // Separates two elements; returns whether they were too close.
  template <class Shape>
  bool separate(const LayerHit& hit);
  // Ends the step; updates the previous positions.
  void finish() {
    if (has_shifted_) before_ = std::move(shifted_before_);
  }

 private:
  // Moves four particles by their weights: by `contact_shift` with friction, and by `return_shift`
  // without adding velocity.
  void move(const LayerHit& hit, const double* coefficients, collide::Vec direction,
            double contact_shift, double return_shift);

  double friction_, max_return_;
  const std::vector<double>& inverse_masses_;
  std::vector<double>&before_, &x_;
  bool separates_at_ends_;
  std::vector<double> shifted_before_;  // previous positions, moved so that no velocity is added
  bool has_shifted_ = false;
};

template <class Shape>
bool Separation::separate(const LayerHit& hit) {
  const Shape current(hit.particles.data(), x_.data());
  const shapes::Nearest nearest = current.nearest();
  if (!nearest.is_interior && !(separates_at_ends_ && hit.side)) return false;
  double gap = length(nearest.offset);
  const double height = hit.side ? hit.side * current.height() : gap;
  if (!(std::min(height, gap) < hit.distance)) return false;
  const bool has_passed_through = height < 0;
  collide::Vec normal = nearest.offset * (1 / gap);
  if (has_passed_through || !(gap > 0)) normal = collide::direction(current.normal(), {0, 0, 1});
  if (has_passed_through) normal = normal * hit.side, gap = height;
  const auto distance = [&](const std::vector<double>& positions) {
    const Shape previous(hit.particles.data(), positions.data());
    return has_passed_through ? hit.side * previous.height() : length(previous.nearest().offset);
  };
  const double start_distance = distance(before_);
  const double target_distance = std::min(hit.distance, start_distance + max_return_);
  const double shifted_distance =
      std::min(hit.distance, has_shifted_ ? distance(shifted_before_) : start_distance);
  const double contact_shift = std::max(0.0, shifted_distance - gap);
  const double return_shift = std::max(0.0, target_distance - std::max(gap, shifted_distance));
  move(hit, nearest.coefficients, normal, contact_shift, return_shift);
  return contact_shift + return_shift > hit.distance * SEPARATION_TOLERANCE;
}

inline void Separation::move(const LayerHit& hit, const double* coefficients,
                             collide::Vec direction, double contact_shift, double return_shift) {
  if (return_shift > 0 && !has_shifted_) shifted_before_ = before_, has_shifted_ = true;
  std::vector<double>& previous = has_shifted_ ? shifted_before_ : before_;
  double weights[4], total_weight = 0, max_weight = 0, max_inverse_mass = 0;
  double *ends[4], *starts[4];
  collide::Vec slip;
  for (std::size_t k = 0; k < 4; ++k) {
    const auto particle = static_cast<std::size_t>(hit.particles[k]);
    ends[k] = &x_[PARTICLE_STRIDE * particle], starts[k] = &previous[PARTICLE_STRIDE * particle];
    weights[k] = inverse_masses_[particle] * coefficients[k];
    total_weight += weights[k] * coefficients[k];
    max_weight = std::max(max_weight, std::abs(weights[k]));
    max_inverse_mass = std::max(max_inverse_mass, inverse_masses_[particle]);
    slip = slip + (collide::load(ends[k]) - collide::load(starts[k])) * coefficients[k];
  }
  total_weight = std::max(
      {total_weight, max_weight / MAX_SHIFT_RATIO, max_inverse_mass * MIN_EFFECTIVE_WEIGHT});
  if (!(total_weight > 0)) return;
  slip = slip - direction * dot(slip, direction);
  const double slip_length = length(slip), friction_limit = friction_ * contact_shift;
  const double friction_fraction = slip_length > friction_limit ? friction_limit / slip_length : 1;
  const collide::Vec return_step = direction * (return_shift / total_weight);
  const collide::Vec contact_step = direction * (contact_shift / total_weight) -
                                    slip * (friction_fraction / total_weight) + return_step;
  for (std::size_t k = 0; k < 4; ++k) {
    collide::store(collide::load(ends[k]) + contact_step * weights[k], ends[k]);
    if (return_shift > 0)
      collide::store(collide::load(starts[k]) + return_step * weights[k], starts[k]);
  }
}

}  // namespace animtool
