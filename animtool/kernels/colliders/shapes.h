// Signed distances and normals of simple shapes, in their own frames.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/poses.h"
#include "colliders/limits.h"

namespace animtool::collide {

// Signed distance of a point, negative inside, and the direction out.
struct Sample {
  double distance;
  Vec normal;
};

inline Sample sample_plane(Vec normal, double offset, Vec p) {
  return {dot(normal, p) - offset, normal};
}

inline Sample sample_sphere(Vec centre, double radius, Vec p) {
  const Vec off = p - centre;
  return {length(off) - radius, direction(off, {0, 1, 0})};
}

// The points within a radius of the segment from a to b.
inline Sample sample_capsule(Vec a, Vec b, double radius, Vec p) {
  const Vec axis = b - a, off = p - a;
  const double squared = dot(axis, axis);
  const double along = squared > 0 ? std::clamp(dot(off, axis) / squared, 0.0, 1.0) : 0.0;
  const Vec away = off - axis * along;
  const double distance = length(away);
  if (distance > 0) return {distance - radius, away * (1 / distance)};
  const Vec out = squared > 0 ? across(axis * (1 / std::sqrt(squared))) : Vec{0, 1, 0};
  return {-radius, out};
}

// A box about the origin, by its half extents.
inline Sample sample_box(Vec half, Vec p) {
  const double sides[3] = {half.x, half.y, half.z}, at[3] = {p.x, p.y, p.z};
  double beyond[3], out[3] = {0, 0, 0}, squared = 0;
  int nearest = 0;
  for (int i = 0; i < 3; ++i) {
    beyond[i] = std::fabs(at[i]) - sides[i];
    if (beyond[i] > beyond[nearest]) nearest = i;
    if (beyond[i] > 0) squared += beyond[i] * beyond[i];
  }
  if (squared > 0) {
    const double distance = std::sqrt(squared);
    for (int i = 0; i < 3; ++i)
      if (beyond[i] > 0) out[i] = std::copysign(beyond[i] / distance, at[i]);
    return {distance, load(out)};
  }
  out[nearest] = std::copysign(1.0, at[nearest]);
  return {beyond[nearest], load(out)};
}

}  // namespace animtool::collide
