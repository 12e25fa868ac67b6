// The rigid motion that fits the displacement of points best.
//
// M. Müller et al., A Robust Method to Extract the Rotational Part of Deformations, 2016.
#pragma once

#include <cmath>
#include <cstddef>

#include "colliders/shapes.h"

namespace animtool {

class RigidMotion {
 public:
  // Fits the motion to the previous and current positions of weighted points.
  template <class From, class To, class Weight>
  RigidMotion(std::size_t count, From from, To to, Weight weight) {
    double total_weight = 0;
    for (std::size_t i = 0; i < count; ++i) {
      start_ = start_ + from(i) * weight(i), end_ = end_ + to(i) * weight(i);
      total_weight += weight(i);
    }
    if (!(total_weight > 0)) return;
    start_ = start_ * (1 / total_weight), end_ = end_ * (1 / total_weight);
    Vec moments[3];  // of end positions with the components of start positions
    for (std::size_t i = 0; i < count; ++i) {
      const Vec arm = (from(i) - start_) * weight(i), image = to(i) - end_;
      moments[0] = moments[0] + image * arm.x, moments[1] = moments[1] + image * arm.y,
      moments[2] = moments[2] + image * arm.z;
    }
    for (int k = 0; k < MAX_UPDATES; ++k) {
      Vec axis;
      double trace = 0;
      for (int c = 0; c < 3; ++c) {
        axis = axis + cross(columns_[c], moments[c]);
        trace += dot(columns_[c], moments[c]);
      }
      axis = axis * (1 / (std::abs(trace) + TRACE_EPSILON));
      const double angle = length(axis);
      if (!(angle > MIN_UPDATE_ANGLE) || !std::isfinite(angle)) break;
      rotate_columns(axis * (1 / angle), angle);
    }
  }

  // The position of a point after the motion.
  Vec operator()(Vec p) const {
    const Vec arm = p - start_;
    return end_ + columns_[0] * arm.x + columns_[1] * arm.y + columns_[2] * arm.z;
  }

 private:
  // Largest number of rotation updates, and the angle below which they stop [rad].
  static constexpr int MAX_UPDATES = 20;
  static constexpr double MIN_UPDATE_ANGLE = 1e-10, TRACE_EPSILON = 1e-300;

  void rotate_columns(Vec n, double angle) {
    const double cosine = std::cos(angle), sine = std::sin(angle);
    for (Vec& v : columns_) v = v * cosine + cross(n, v) * sine + n * (dot(n, v) * (1 - cosine));
  }

  Vec start_, end_, columns_[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
};

}  // namespace animtool
