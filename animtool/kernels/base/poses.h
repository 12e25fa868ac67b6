// Directions, and rigid transforms.
#pragma once

#include "base/quaternions.h"
#include "base/vector.h"

namespace animtool::collide {

using animtool::length;
using animtool::load;
using animtool::store;
using animtool::Vec;

// The unit vector along a vector; the fallback for zero length.
inline Vec direction(Vec a, Vec fallback) {
  const double n = length(a);
  return n > 0 ? a * (1 / n) : fallback;
}

// A unit vector orthogonal to a unit vector.
inline Vec orthogonal(Vec a) {
  const double in[3] = {a.x, a.y, a.z};
  double u[3], v[3];
  ik::orthogonal_basis(in, u, v);
  return load(u);
}

// A rigid transform world_from_local.
struct Pose {
  Vec origin;
  double rotation[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

  Vec rotate(Vec a) const {
    return {rotation[0] * a.x + rotation[1] * a.y + rotation[2] * a.z,
            rotation[3] * a.x + rotation[4] * a.y + rotation[5] * a.z,
            rotation[6] * a.x + rotation[7] * a.y + rotation[8] * a.z};
  }
  Vec inverse_rotate(Vec a) const {
    return {rotation[0] * a.x + rotation[3] * a.y + rotation[6] * a.z,
            rotation[1] * a.x + rotation[4] * a.y + rotation[7] * a.z,
            rotation[2] * a.x + rotation[5] * a.y + rotation[8] * a.z};
  }
  Vec to_world(Vec local) const { return origin + rotate(local); }
  Vec to_local(Vec world) const { return inverse_rotate(world - origin); }
};

// Motion between two poses: linear translation, constant angular velocity.
class Motion {
 public:
  Motion() = default;

  // A pose is an origin and a quaternion x y z w, of any length above 0.
  Motion(const double* start, const double* end) {
    double start_rotation[4], end_rotation[4], inverse[4], relative_rotation[4], rotation[3];
    for (int i = 0; i < 4; ++i) start_rotation[i] = start[3 + i], end_rotation[i] = end[3 + i];
    ik::normalize(start_rotation);
    ik::normalize(end_rotation);
    for (int i = 0; i < 4; ++i) inverse[i] = i < 3 ? -start_rotation[i] : start_rotation[i];
    ik::product(end_rotation, inverse, relative_rotation);
    ik::logarithm(relative_rotation, rotation);
    for (int i = 0; i < 4; ++i) start_rotation_[i] = start_rotation[i];
    rotation_ = load(rotation);
    origin_ = load(start);
    translation_ = load(end) - origin_;
    is_rotating_ = length(rotation_) > 0;
    ik::to_matrix(start_rotation, start_pose_.rotation);
    start_pose_.origin = origin_;
    is_moving_ = is_rotating_ || length(translation_) > 0;
  }

  bool is_moving() const { return is_moving_; }
  Vec translation() const { return translation_; }
  Vec rotation() const { return rotation_; }
  double angle() const { return length(rotation_); }

  // The pose at a fraction of the step, from 0 to 1.
  Pose pose_at(double fraction) const {
    if (!is_moving_) return start_pose_;
    Pose pose = start_pose_;
    pose.origin = origin_ + translation_ * fraction;
    if (is_rotating_) {
      const double vector[3] = {rotation_.x * fraction, rotation_.y * fraction,
                                rotation_.z * fraction};
      double partial_rotation[4], rotation[4];
      ik::exponential(vector, partial_rotation);
      ik::product(partial_rotation, start_rotation_, rotation);
      ik::normalize(rotation);
      ik::to_matrix(rotation, pose.rotation);
    }
    return pose;
  }

  // Displacement per step of a world point that moves with the body, at the velocity that it has in
  // a given pose.
  Vec displacement(Vec point, const Pose& pose) const {
    return translation_ + cross(rotation_, point - pose.origin);
  }

  // The same motion over a fraction of the step.
  Motion sub_motion(double from, double to) const {
    Motion result = *this;
    const Pose pose = pose_at(from);
    const double vector[3] = {rotation_.x * from, rotation_.y * from, rotation_.z * from};
    double partial_rotation[4];
    ik::exponential(vector, partial_rotation);
    ik::product(partial_rotation, start_rotation_, result.start_rotation_);
    result.origin_ = pose.origin;
    result.translation_ = translation_ * (to - from);
    result.rotation_ = rotation_ * (to - from);
    result.start_pose_ = pose;
    return result;
  }

 private:
  Vec origin_, translation_, rotation_;
  double start_rotation_[4] = {0, 0, 0, 1};
  Pose start_pose_;
  bool is_rotating_ = false, is_moving_ = false;
};

}  // namespace animtool::collide
