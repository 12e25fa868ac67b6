// Signed distances and normals of primitive shapes, in their local frames.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/poses.h"
#include "colliders/limits.h"

namespace animtool::collide {

// Signed distance of a point, negative inside, and the outward direction.
struct Sample {
  double distance;
  Vec normal;
};

inline Sample sample_plane(Vec normal, double offset, Vec p) {
  return {dot(normal, p) - offset, normal};
}

inline Sample sample_sphere(Vec centre, double radius, Vec p) {
  const Vec offset = p - centre;
  return {length(offset) - radius, direction(offset, {0, 1, 0})};
}

// A capsule: all points within a radius of the segment from a to b.
inline Sample sample_capsule(Vec a, Vec b, double radius, Vec p) {
  const Vec axis = b - a, offset = p - a;
  const double squared = dot(axis, axis);
  const double fraction = squared > 0 ? std::clamp(dot(offset, axis) / squared, 0.0, 1.0) : 0.0;
  const Vec radial = offset - axis * fraction;
  const double distance = length(radial);
  if (distance > 0) return {distance - radius, radial * (1 / distance)};
  const Vec normal = squared > 0 ? orthogonal(axis * (1 / std::sqrt(squared))) : Vec{0, 1, 0};
  return {-radius, normal};
}

// A box around the origin with these half extents.
inline Sample sample_box(Vec half_extents, Vec p) {
  const double extents[3] = {half_extents.x, half_extents.y, half_extents.z},
               coordinates[3] = {p.x, p.y, p.z};
  double excess[3], normal[3] = {0, 0, 0}, squared = 0;
  int nearest_axis = 0;
  for (int i = 0; i < 3; ++i) {
    excess[i] = std::fabs(coordinates[i]) - extents[i];
    if (excess[i] > excess[nearest_axis]) nearest_axis = i;
    if (excess[i] > 0) squared += excess[i] * excess[i];
  }
  if (squared > 0) {
    const double distance = std::sqrt(squared);
    for (int i = 0; i < 3; ++i)
      if (excess[i] > 0) normal[i] = std::copysign(excess[i] / distance, coordinates[i]);
    return {distance, load(normal)};
  }
  normal[nearest_axis] = std::copysign(1.0, coordinates[nearest_axis]);
  return {excess[nearest_axis], load(normal)};
}

}  // namespace animtool::collide
