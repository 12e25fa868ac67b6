// Contacts of four particles at once in a step: distances from a capsule, and positions after
// contact.
#pragma once

#include "base/wide.h"
#include "colliders/limits.h"

namespace animtool::collide {

// A capsule over a step, in the world [m].
struct Rod {
  struct Axis {
    double from[3], along[3];
    double inverse;     // 1 over its squared length, 0 for a sphere
    double outward[3];  // the direction out for points on the axis
  };
  Axis begin, end;
  double radius;  // including margins
  // Displacement in the step: its points p move by travel + rotation × (p - origin).
  double travel[3], rotation[3], origin[3];
  double friction;
  // How far a particle that starts too deep is moved out.
  double max_rise;
};

// For one particle, components are single numbers.
[[maybe_unused]] static double sqrt(double a) { return std::sqrt(a); }
[[maybe_unused]] static double inverse(double a) { return a > 0 ? 1 / a : 0; }
[[maybe_unused]] static double min(double a, double b) { return a < b ? a : b; }
[[maybe_unused]] static double max(double a, double b) { return a > b ? a : b; }
[[maybe_unused]] static double less(double a, double b) { return a < b; }
[[maybe_unused]] static double select(double where, double a, double b) {
  return where != 0 ? a : b;
}
[[maybe_unused]] static Vec select(double where, const Vec& a, const Vec& b) {
  return where != 0 ? a : b;
}
[[maybe_unused]] static unsigned mask_bits(double where) { return where != 0; }

template <class N>
struct WideSample {
  N distance;
  Vector3<N> normal;
};

template <class N>
WideSample<N> sample_rod(const Rod::Axis& axis, double radius, const Vector3<N>& p) {
  using V = Vector3<N>;
  const V off = p - V::broadcast(axis.from), along = V::broadcast(axis.along);
  const N fraction = min(max(dot(off, along) * axis.inverse, N(0.0)), N(1.0));
  const V away = off - along * fraction;
  const N square = dot(away, away), length = sqrt(square);
  const V normal = away * inverse(length);
  return {length - radius, select(less(N(0.0), length), normal, V::broadcast(axis.outward))};
}

// Moves particles that are too deep at the end of a step: to the surface, or slowly outwards if
// they started too deep, with friction along the surface. Slow motion outwards adds no speed: the
// position that counts as at rest moves too. Returns which particles were moved.
template <class N>
unsigned push_out(const Rod& rod, const WideSample<N>& hit, const N& start_distance, const N& depth,
                  const Vector3<N>& from, Vector3<N>& to, Vector3<N>& unmoved) {
  using V = Vector3<N>;
  const N slow = min(start_distance + rod.max_rise, depth);
  const auto deep = less(start_distance, depth - INSIDE);
  const N goal = select(deep, slow, depth);
  const N out = goal - hit.distance;
  const N pushed = less(N(TOUCH), out);
  const V transported =
      V::broadcast(rod.travel) + cross(V::broadcast(rod.rotation), to - V::broadcast(rod.origin));
  const V location = to + hit.normal * out, shift = location - from - transported;
  const V slip = shift - hit.normal * dot(shift, hit.normal);
  const N most = sqrt(dot(slip, slip)), pinned = out * rod.friction;
  // A particle that friction holds does not slip at all.
  const N fraction = select(less(pinned, most), pinned * inverse(most), N(1.0));
  to = select(pushed, location - slip * fraction, to);
  const N gained = dot(to - unmoved - transported, hit.normal);
  const V relative = select(less(N(0.0), gained), unmoved + hit.normal * gained, unmoved);
  unmoved = select(pushed, select(deep, relative, unmoved), unmoved);
  return mask_bits(pushed);
}

}  // namespace animtool::collide
