// Best-fit rigid motion of point displacements.
//
// M. Müller et al., A Robust Method to Extract the Rotational Part of Deformations, 2016.
#pragma once

#include <cmath>
#include <cstddef>

#include "colliders/shapes.h"

namespace animtool {

class RigidMotion {
 public:
  // From the previous and current positions of weighted points.
  template <class From, class To, class Weight>
  RigidMotion(std::size_t count, From from, To to, Weight weight) {
    double full = 0;
    for (std::size_t i = 0; i < count; ++i) {
      start_ = start_ + from(i) * weight(i), end_ = end_ + to(i) * weight(i);
      full += weight(i);
    }
    if (!(full > 0)) return;
    start_ = start_ * (1 / full), end_ = end_ * (1 / full);
    Vec sums[3];  // of ends, times the components of starts
    for (std::size_t i = 0; i < count; ++i) {
      const Vec arm = (from(i) - start_) * weight(i), at = to(i) - end_;
      sums[0] = sums[0] + at * arm.x, sums[1] = sums[1] + at * arm.y,
      sums[2] = sums[2] + at * arm.z;
    }
    for (int k = 0; k < MAX_ROTATIONS; ++k) {
      Vec axis;
      double along = 0;
      for (int c = 0; c < 3; ++c) {
        axis = axis + cross(columns_[c], sums[c]);
        along += dot(columns_[c], sums[c]);
      }
      axis = axis * (1 / (std::abs(along) + EPSILON));
      const double angle = length(axis);
      if (!(angle > MIN_ROTATION) || !std::isfinite(angle)) break;
      rotation(axis * (1 / angle), angle);
    }
  }

  // The image of a point.
  Vec operator()(Vec p) const {
    const Vec arm = p - start_;
    return end_ + columns_[0] * arm.x + columns_[1] * arm.y + columns_[2] * arm.z;
  }

 private:
  // Largest number of rotation updates, and the angle below which they end [rad].
  static constexpr int MAX_ROTATIONS = 20;
  static constexpr double MIN_ROTATION = 1e-10, EPSILON = 1e-300;

  void rotation(Vec n, double angle) {
    const double c = std::cos(angle), s = std::sin(angle);
    for (Vec& v : columns_) v = v * c + cross(n, v) * s + n * (dot(n, v) * (1 - c));
  }

  Vec start_, end_, columns_[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
};

}  // namespace animtool
