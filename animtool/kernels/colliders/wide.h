// Contacts of four particles at once in a step: distances from a capsule, and positions after
// contact.
#pragma once

#include "base/wide.h"
#include "colliders/limits.h"

namespace animtool::collide {

// A capsule that moves over a step, in the world [m].
struct MovingCapsule {
  struct Axis {
    double start[3], vector[3];
    double inverse_squared_length;  // 0 for a sphere
    double outward[3];              // outward direction for points on the axis
  };
  Axis begin, end;
  double radius;  // including margins
  // Motion in the step: points p are displaced by translation + rotation × (p - origin).
  double translation[3], rotation[3], origin[3];
  double friction;
  // Largest distance that a particle that starts inside is moved outwards.
  double max_push;
};

// The operations of SIMD numbers for a single particle.
[[maybe_unused]] static double sqrt(double a) { return std::sqrt(a); }
[[maybe_unused]] static double inverse(double a) { return a > 0 ? 1 / a : 0; }
[[maybe_unused]] static double min(double a, double b) { return a < b ? a : b; }
[[maybe_unused]] static double max(double a, double b) { return a > b ? a : b; }
[[maybe_unused]] static double less(double a, double b) { return a < b; }
[[maybe_unused]] static double select(double mask, double a, double b) { return mask != 0 ? a : b; }
[[maybe_unused]] static Vec select(double mask, const Vec& a, const Vec& b) {
  return mask != 0 ? a : b;
}
[[maybe_unused]] static unsigned mask_bits(double mask) { return mask != 0; }

// Signed distances and normals of four particles, or of one.
template <class N>
struct WideSample {
  N distance;
  Vector3<N> normal;
};

template <class N>
WideSample<N> sample_moving_capsule(const MovingCapsule::Axis& axis, double radius,
                                    const Vector3<N>& p) {
  using V = Vector3<N>;
  const V offset = p - V::broadcast(axis.start), vector = V::broadcast(axis.vector);
  const N fraction = min(max(dot(offset, vector) * axis.inverse_squared_length, N(0.0)), N(1.0));
  const V radial = offset - vector * fraction;
  const N squared_length = dot(radial, radial), length = sqrt(squared_length);
  const V normal = radial * inverse(length);
  return {length - radius, select(less(N(0.0), length), normal, V::broadcast(axis.outward))};
}

// Moves particles that are too deep at the end of a step: to the surface, or slowly outwards if
// they started too deep, with friction along the surface. Slow outward motion adds no velocity:
// `reference`, the position relative to which velocities are measured, moves too. Returns a bit per
// particle: set if it was moved.
template <class N>
unsigned push_out(const MovingCapsule& capsule, const WideSample<N>& hit, const N& start_distance,
                  const N& depth, const Vector3<N>& from, Vector3<N>& to, Vector3<N>& reference) {
  using V = Vector3<N>;
  const N slow_distance = min(start_distance + capsule.max_push, depth);
  const auto is_deep_at_start = less(start_distance, depth - INSIDE_DEPTH);
  const N target_distance = select(is_deep_at_start, slow_distance, depth);
  const N correction = target_distance - hit.distance;
  const N is_pushed = less(N(TOUCH_DISTANCE), correction);
  const V transported = V::broadcast(capsule.translation) +
                        cross(V::broadcast(capsule.rotation), to - V::broadcast(capsule.origin));
  const V location = to + hit.normal * correction, relative_shift = location - from - transported;
  const V slip = relative_shift - hit.normal * dot(relative_shift, hit.normal);
  const N slip_length = sqrt(dot(slip, slip)), friction_length = correction * capsule.friction;
  // A particle that friction holds does not slip at all.
  const N fraction =
      select(less(friction_length, slip_length), friction_length * inverse(slip_length), N(1.0));
  to = select(is_pushed, location - slip * fraction, to);
  const N outward_gain = dot(to - reference - transported, hit.normal);
  const V shifted_reference =
      select(less(N(0.0), outward_gain), reference + hit.normal * outward_gain, reference);
  reference = select(is_pushed, select(is_deep_at_start, shifted_reference, reference), reference);
  return mask_bits(is_pushed);
}

}  // namespace animtool::collide
