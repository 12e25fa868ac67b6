// Directions, and rigid transforms.
#pragma once

#include "base/quaternions.h"
#include "base/vector.h"

namespace animtool::collide {

using animtool::length;
using animtool::load;
using animtool::store;
using animtool::Vec;

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
  double rotation[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

  Vec rotated(Vec a) const {
    return {rotation[0] * a.x + rotation[1] * a.y + rotation[2] * a.z,
            rotation[3] * a.x + rotation[4] * a.y + rotation[5] * a.z,
            rotation[6] * a.x + rotation[7] * a.y + rotation[8] * a.z};
  }
  Vec unrotated(Vec a) const {
    return {rotation[0] * a.x + rotation[3] * a.y + rotation[6] * a.z,
            rotation[1] * a.x + rotation[4] * a.y + rotation[7] * a.z,
            rotation[2] * a.x + rotation[5] * a.y + rotation[8] * a.z};
  }
  Vec to_world(Vec local) const { return origin + rotated(local); }
  Vec to_local(Vec world) const { return unrotated(world - origin); }
};

// Motion between two poses: linear translation, constant angular velocity.
class Motion {
 public:
  Motion() = default;

  // A pose is an origin and a quaternion x y z w, of any length above 0.
  Motion(const double* start, const double* end) {
    double first[4], last[4], inverse[4], between[4], rotation[3];
    for (int i = 0; i < 4; ++i) first[i] = start[3 + i], last[i] = end[3 + i];
    ik::normalize(first);
    ik::normalize(last);
    for (int i = 0; i < 4; ++i) inverse[i] = i < 3 ? -first[i] : first[i];
    ik::product(last, inverse, between);
    ik::logarithm(between, rotation);
    for (int i = 0; i < 4; ++i) first_[i] = first[i];
    rotation_ = load(rotation);
    origin_ = load(start);
    travel_ = load(end) - origin_;
    rotates_ = length(rotation_) > 0;
    ik::to_matrix(first, unrotated_.rotation);
    unrotated_.origin = origin_;
    moves_ = rotates_ || length(travel_) > 0;
  }

  bool moves() const { return moves_; }
  Vec travel() const { return travel_; }
  Vec rotation() const { return rotation_; }
  double angle() const { return length(rotation_); }

  // The pose at a fraction of the step, from 0 to 1.
  Pose at(double fraction) const {
    if (!moves_) return unrotated_;
    Pose pose = unrotated_;
    pose.origin = origin_ + travel_ * fraction;
    if (rotates_) {
      const double vector[3] = {rotation_.x * fraction, rotation_.y * fraction,
                                rotation_.z * fraction};
      double step[4], full[4];
      ik::exponential(vector, step);
      ik::product(step, first_, full);
      ik::normalize(full);
      ik::to_matrix(full, pose.rotation);
    }
    return pose;
  }

  // Velocity, per step, of a world point that moves along, in a pose during the step.
  Vec displacement(Vec point, const Pose& pose) const {
    return travel_ + cross(rotation_, point - pose.origin);
  }

  // The same motion over a part of the step.
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
