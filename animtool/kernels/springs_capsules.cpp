// Contacts of particles with capsules that move.
#include "springs_capsules.h"

#include <algorithm>
#include <stdexcept>

#include "collide_shapes.h"

namespace animtool {

namespace {

using collide::Vec;
using collide::load;
using collide::store;

// Where on the axis from a to b the nearest place to a point is.
double share_of(Vec a, Vec b, Vec p) {
  const Vec axis = b - a;
  const double squared = dot(axis, axis);
  return squared > 0 ? std::clamp(dot(p - a, axis) / squared, 0.0, 1.0) : 0.0;
}

// A ball about a capsule: its centre, and its radius squared or a little more.
struct Ball {
  Vec centre;
  double reach;

  bool has(Vec p) const {
    const Vec off = p - centre;
    return dot(off, off) <= reach;
  }
};

Ball ball_about(Vec a, Vec b, double radius) {
  const double whole = radius + length(b - a) * 0.5;
  return {(a + b) * 0.5, whole * whole * (1 + 1e-9)};
}

}  // namespace

SpringCapsules::SpringCapsules(In<double, 1> knots, In<double, 3> ends, In<double, 1> radii,
                               In<double, 2> depths, double friction, double depenetration)
    : particles_(depths.shape(1)),
      knots_(knots.data(), knots.data() + knots.size()),
      radii_(radii.data(), radii.data() + radii.size()),
      depths_(depths.data(), depths.data() + depths.size()),
      track_{{ends.data(), ends.data() + ends.size()}, 2 * radii.shape(0),
             ends.shape(0) == 1},
      friction_(friction),
      depenetration_(depenetration),
      was_(6 * radii.shape(0)),
      now_(6 * radii.shape(0)) {
  if (knots_.empty()) throw std::invalid_argument("there is at least one knot");
  if (ends.shape(1) != 2 * radii_.size() || ends.shape(2) != 3 ||
      (ends.shape(0) != 1 && ends.shape(0) != knots_.size()))
    throw std::invalid_argument("ends are (K or 1, 2 C, 3)");
  if (depths.shape(0) != radii_.size()) throw std::invalid_argument("depths are (C, N)");
}

void SpringCapsules::place(double t, std::vector<double>& ends) const {
  SpringNetwork::follow(track_, spot_of(knots_, t), ends.data());
}

std::int64_t SpringCapsules::keep_out(double t, double h,
                                      const std::vector<double>& inverse_masses,
                                      const double* before, double* x) {
  place(t, was_);
  place(t + h, now_);
  std::vector<Ball> balls;
  for (std::size_t c = 0; c < radii_.size(); ++c)
    balls.push_back(ball_about(load(&now_[6 * c]), load(&now_[6 * c + 3]), radii_[c]));
  std::int64_t moved = 0;
  for (std::size_t n = 0; n < particles_; ++n) {
    if (inverse_masses[n] == 0) continue;
    Vec p = load(x + ROW * n);
    bool hit = false;
    for (std::size_t c = 0; c < radii_.size(); ++c) {
      if (!balls[c].has(p)) continue;
      const Vec a = load(&now_[6 * c]), b = load(&now_[6 * c + 3]);
      const auto ended = collide::sample_capsule(a, b, radii_[c], p);
      const double least = depths_[c * particles_ + n];
      if (ended.distance >= least) continue;
      const Vec old = load(before + ROW * n);
      const Vec a0 = load(&was_[6 * c]), b0 = load(&was_[6 * c + 3]);
      const double begun = collide::sample_capsule(a0, b0, radii_[c], old).distance;
      const double push = std::min(begun + depenetration_ * h, least) - ended.distance;
      if (!(push > 0)) continue;
      hit = true;
      const double share = share_of(a, b, p);
      const Vec surface = (a - a0) * (1 - share) + (b - b0) * share;
      p = p + ended.normal * push;
      Vec slip = p - old - surface;
      slip = slip - ended.normal * dot(slip, ended.normal);
      const double size = length(slip);
      if (size > 0) p = p - slip * (std::min(friction_ * push, size) / size);
    }
    if (!hit) continue;
    store(p, x + ROW * n);
    ++moved;
  }
  return moved;
}

std::int64_t SpringCapsules::inside(double t, double tolerance,
                                    const std::vector<double>& inverse_masses,
                                    const double* x) {
  place(t, now_);
  std::int64_t count = 0;
  for (std::size_t n = 0; n < particles_; ++n) {
    if (inverse_masses[n] == 0) continue;
    bool deep = false;
    for (std::size_t c = 0; c < radii_.size() && !deep; ++c) {
      const auto found = collide::sample_capsule(load(&now_[6 * c]), load(&now_[6 * c + 3]),
                                                 radii_[c], load(x + ROW * n));
      deep = found.distance < depths_[c * particles_ + n] - tolerance;
    }
    count += deep;
  }
  return count;
}

}  // namespace animtool
