// Directions, and rigid transforms.
#pragma once

#include "base/quaternions.h"
#include "base/vector.h"

namespace animtool::collide {

using animtool::Vec;
using animtool::length;
using animtool::load;
using animtool::store;

// A normalised vector; the fallback for zero length.
inline Vec direction(Vec a, Vec fallback) {
  const double n = length(a);
  return n > 0 ? a * (1 / n) : fallback;
}

// A unit vector orthogonal to a unit vector.
inline Vec across(Vec a) {
  const double in[3] = {a.x, a.y, a.z};
  double u[3], v[3];
  ik::across(in, u, v);
  return load(u);
}

// A rigid transform world_from_local.
struct Pose {
  Vec origin;
  double turn[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

  Vec rotated(Vec a) const {
    return {turn[0] * a.x + turn[1] * a.y + turn[2] * a.z,
            turn[3] * a.x + turn[4] * a.y + turn[5] * a.z,
            turn[6] * a.x + turn[7] * a.y + turn[8] * a.z};
  }
  Vec unrotated(Vec a) const {
    return {turn[0] * a.x + turn[3] * a.y + turn[6] * a.z,
            turn[1] * a.x + turn[4] * a.y + turn[7] * a.z,
            turn[2] * a.x + turn[5] * a.y + turn[8] * a.z};
  }
  Vec to_world(Vec local) const { return origin + rotated(local); }
  Vec to_local(Vec world) const { return unrotated(world - origin); }
};

// Motion between two poses: linear translation, constant angular velocity.
class Motion {
 public:
  Motion() = default;

  // Poses are an origin and a quaternion x y z w, of any length above 0.
  Motion(const double* start, const double* end) {
    double first[4], last[4], inverse[4], between[4], turn[3];
    for (int i = 0; i < 4; ++i) first[i] = start[3 + i], last[i] = end[3 + i];
    ik::normalize(first);
    ik::normalize(last);
    for (int i = 0; i < 4; ++i) inverse[i] = i < 3 ? -first[i] : first[i];
    ik::product(last, inverse, between);
    ik::logarithm(between, turn);
    for (int i = 0; i < 4; ++i) first_[i] = first[i];
    rotation_ = load(turn);
    origin_ = load(start);
    travel_ = load(end) - origin_;
    rotates_ = length(rotation_) > 0;
    ik::to_matrix(first, unrotated_.turn);
    unrotated_.origin = origin_;
    moves_ = rotates_ || length(travel_) > 0;
  }

  bool moves() const { return moves_; }
  Vec travel() const { return travel_; }
  Vec turn() const { return rotation_; }
  double angle() const { return length(rotation_); }

  // The pose at a fraction of the step from 0 to 1.
  Pose at(double fraction) const {
    if (!moves_) return unrotated_;
    Pose pose = unrotated_;
    pose.origin = origin_ + travel_ * fraction;
    if (rotates_) {
      const double vector[3] = {rotation_.x * fraction, rotation_.y * fraction, rotation_.z * fraction};
      double step[4], full[4];
      ik::exponential(vector, step);
      ik::product(step, first_, full);
      ik::normalize(full);
      ik::to_matrix(full, pose.turn);
    }
    return pose;
  }

  // How a world point that it carries moves in the step at a share of it.
  Vec displacement(Vec point, const Pose& pose) const {
    return travel_ + cross(rotation_, point - pose.origin);
  }

  // The same motion over a part of its step.
  Motion part(double from, double to) const {
    Motion result = *this;
    const Pose pose = at(from);
    const double vector[3] = {rotation_.x * from, rotation_.y * from, rotation_.z * from};
    double step[4];
    ik::exponential(vector, step);
    ik::product(step, first_, result.first_);
    result.origin_ = pose.origin;
    result.travel_ = travel_ * (to - from);
    result.rotation_ = rotation_ * (to - from);
    result.unrotated_ = pose;
    return result;
  }

 private:
  Vec origin_, travel_, rotation_;
  double first_[4] = {0, 0, 0, 1};
  Pose unrotated_;
  bool rotates_ = false, moves_ = false;
};

}  // namespace animtool::collide
