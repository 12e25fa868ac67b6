// Tests of vertices against triangles and of edges against edges: closest points, sides, and
// continuous crossing.
//
// C. Ericson, Real-Time Collision Detection, 2005, 5.1.5 and 5.1.9; R. Bridson et al., Robust
// Treatment of Collisions, Contact and Friction for Cloth Animation, 2002, 6.1.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include "colliders/mesh.h"
#include "springs/rows.h"

namespace animtool::shapes {

using collide::Vec;

// Margin beyond the sides of a triangle, or the ends of an edge, in which points count as inside
// [1].
constexpr double BOUNDARY_MARGIN = 1e-6;
// Squared sine of the angle below which edges are parallel: closest at an end, and without a side.
constexpr double PARALLEL_SINE_SQUARED = 1e-8;
// Iterations to find the time of a crossing, and the relative tolerance of the height [1].
constexpr int MAX_ROOT_ITERATIONS = 8;
constexpr double CROSSING_TOLERANCE = 1e-3;

// The position in the row of a particle.
inline Vec position_of(const double* positions, std::int32_t particle) {
  return collide::load(positions + PARTICLE_STRIDE * static_cast<std::size_t>(particle));
}
inline Vec interpolate(Vec a, Vec b, double fraction) { return a + (b - a) * fraction; }

// Closest points of two elements: the offset from the second to the first, and the coefficients of
// the four particles in it. `is_interior` is false if an edge is closest at an end.
struct Nearest {
  Vec offset;
  double coefficients[4];
  bool is_interior = true;
};

struct Triangle {
  Vec a, b, c;

  Triangle(Vec a0, Vec b0, Vec c0) : a(a0), b(b0), c(c0) {}
  Triangle(const std::int32_t* corners, const double* positions)
      : a(position_of(positions, corners[0])),
        b(position_of(positions, corners[1])),
        c(position_of(positions, corners[2])) {}

  // The closest point to p.
  Nearest nearest(Vec p) const {
    const collide::Barycentric coordinates = collide::barycentric_of_nearest(p, a, b, c);
    return {p - (a + (b - a) * coordinates.b + (c - a) * coordinates.c),
            {1, -(1 - coordinates.b - coordinates.c), -coordinates.b, -coordinates.c}};
  }
  double distance(Vec p) const { return length(nearest(p).offset); }
  // The unit normal; zero without area.
  Vec normal() const { return collide::direction(cross(b - a, c - a), Vec{}); }
};

struct Segment {
  Vec a, b;

  Segment(Vec a0, Vec b0) : a(a0), b(b0) {}
  Segment(const std::int32_t* ends, const double* positions)
      : a(position_of(positions, ends[0])), b(position_of(positions, ends[1])) {}

  Vec vector() const { return b - a; }
  Vec point_at(double fraction) const { return interpolate(a, b, fraction); }
};

// A corner and a triangle.
struct CornerPair {
  Vec p;
  Triangle triangle;

  CornerPair(const std::int32_t* particles, const double* positions)
      : p(position_of(positions, particles[0])), triangle(particles + 1, positions) {}
  CornerPair(Vec p0, const Triangle& t) : p(p0), triangle(t) {}

  Nearest nearest() const { return triangle.nearest(p); }
  // The unit normal, towards positive heights; zero if undefined.
  Vec normal() const { return triangle.normal(); }
  // Height of the corner above the plane of the triangle.
  double height() const { return dot(p - triangle.a, normal()); }
  // The pair at a fraction of linear paths to another pair.
  CornerPair interpolated(const CornerPair& end, double fraction) const {
    const Triangle &from = triangle, &to = end.triangle;
    return {interpolate(p, end.p, fraction),
            {interpolate(from.a, to.a, fraction), interpolate(from.b, to.b, fraction),
             interpolate(from.c, to.c, fraction)}};
  }
  // Three vectors that are coplanar when the corner is in the plane of the triangle.
  std::array<Vec, 3> volume_vectors() const {
    return {p - triangle.a, triangle.b - triangle.a, triangle.c - triangle.a};
  }
  // Whether the corner projects into the triangle, along its normal.
  bool is_projected_inside() const {
    const Vec ab = triangle.b - triangle.a, ac = triangle.c - triangle.a, ap = p - triangle.a;
    const double bb = dot(ab, ab), bc = dot(ab, ac), cc = dot(ac, ac);
    const double squared_area = bb * cc - bc * bc;
    if (!(squared_area > 0)) return false;
    const double b = (cc * dot(ap, ab) - bc * dot(ap, ac)) / squared_area;
    const double c = (bb * dot(ap, ac) - bc * dot(ap, ab)) / squared_area;
    return b >= -BOUNDARY_MARGIN && c >= -BOUNDARY_MARGIN && b + c <= 1 + BOUNDARY_MARGIN;
  }
};

// Two edges.
struct EdgePair {
  Segment first, second;

  EdgePair(const std::int32_t* particles, const double* positions)
      : first(particles, positions), second(particles + 2, positions) {}
  EdgePair(const Segment& first_edge, const Segment& second_edge)
      : first(first_edge), second(second_edge) {}

  Nearest nearest() const {
    const Vec d = first.vector(), e = second.vector(), r = first.a - second.a;
    const double dd = dot(d, d), ee = dot(e, e), de = dot(d, e), dr = dot(d, r), er = dot(e, r);
    const double squared_area = dd * ee - de * de;
    double s = 0, t = 0;
    bool is_interior = squared_area > PARALLEL_SINE_SQUARED * dd * ee;
    if (is_interior) s = (de * er - ee * dr) / squared_area;
    is_interior = is_interior && s > 0 && s < 1;
    s = std::clamp(s, 0.0, 1.0);
    if (ee > 0) t = (de * s + er) / ee;
    if (!(t > 0 && t < 1)) {
      is_interior = false;
      t = std::clamp(t, 0.0, 1.0);
      s = dd > 0 ? std::clamp((de * t - dr) / dd, 0.0, 1.0) : 0.0;
    }
    return {first.point_at(s) - second.point_at(t), {1 - s, s, -(1 - t), -t}, is_interior};
  }
  Vec normal() const {
    const Vec d = first.vector(), e = second.vector(), n = cross(d, e);
    return dot(n, n) > PARALLEL_SINE_SQUARED * dot(d, d) * dot(e, e) ? collide::direction(n, Vec{})
                                                                     : Vec{};
  }
  // Distance of the lines of the edges, positive on the side of the normal.
  double height() const { return dot(first.a - second.a, normal()); }
  EdgePair interpolated(const EdgePair& end, double fraction) const {
    const auto interpolate_edge = [fraction](const Segment& from, const Segment& to) {
      return Segment(interpolate(from.a, to.a, fraction), interpolate(from.b, to.b, fraction));
    };
    return {interpolate_edge(first, end.first), interpolate_edge(second, end.second)};
  }
  // Three vectors that are coplanar when the edges are.
  std::array<Vec, 3> volume_vectors() const {
    return {first.a - second.a, first.vector(), second.vector()};
  }
  // Whether the lines of the edges are closest at points of both edges.
  bool is_projected_inside() const {
    const Vec d = first.vector(), e = second.vector(), r = first.a - second.a;
    const double dd = dot(d, d), ee = dot(e, e), de = dot(d, e);
    const double squared_area = dd * ee - de * de;
    if (!(squared_area > PARALLEL_SINE_SQUARED * dd * ee)) return false;
    const double s = (de * dot(e, r) - ee * dot(d, r)) / squared_area;
    const double t = (dd * dot(e, r) - de * dot(d, r)) / squared_area;
    return s >= -BOUNDARY_MARGIN && s <= 1 + BOUNDARY_MARGIN && t >= -BOUNDARY_MARGIN &&
           t <= 1 + BOUNDARY_MARGIN;
  }
};

// The side (1 or -1) from which the first element passes through the second on linear paths; 0 if
// it does not. If only the normal flips, the elements do not touch.
template <class Pair>
std::int32_t crossing_side(const Pair& from, const Pair& to) {
  const double start_height = from.height(), end_height = to.height();
  if ((start_height >= 0) == (end_height >= 0) || !(std::abs(start_height - end_height) > 0))
    return 0;
  double low = 0, high = 1, low_height = start_height, high_height = end_height;
  for (int i = 0; i < MAX_ROOT_ITERATIONS; ++i) {
    const double fraction = low + (high - low) * low_height / (low_height - high_height);
    const Pair crossing = from.interpolated(to, fraction);
    const double height = crossing.height();
    if (std::abs(height) <= CROSSING_TOLERANCE * std::abs(start_height - end_height))
      return !crossing.is_projected_inside() ? 0 : start_height >= 0 ? 1 : -1;
    if ((height >= 0) == (start_height >= 0))
      low = fraction, low_height = height, high_height /= 2;
    else
      high = fraction, high_height = height, low_height /= 2;
  }
  return 0;
}

// The volume spanned by three vectors that change linearly with time: a cubic polynomial of the
// fraction, in Bernstein form.
struct Volume {
  double coefficients[4];

  Volume(const std::array<Vec, 3>& from, const std::array<Vec, 3>& to) {
    const auto triple_product = [](Vec a, Vec b, Vec c) { return dot(a, cross(b, c)); };
    const auto& [a, b, c] = from;
    const auto& [u, v, w] = to;
    coefficients[0] = triple_product(a, b, c);
    coefficients[1] =
        (triple_product(u, b, c) + triple_product(a, v, c) + triple_product(a, b, w)) / 3;
    coefficients[2] =
        (triple_product(u, v, c) + triple_product(u, b, w) + triple_product(a, v, w)) / 3;
    coefficients[3] = triple_product(u, v, w);
  }
  double operator()(double t) const {
    const double s = 1 - t;
    return s * s * (s * coefficients[0] + 3 * t * coefficients[1]) +
           t * t * (3 * s * coefficients[2] + t * coefficients[3]);
  }
  bool has_constant_sign() const {
    return (coefficients[0] > 0 && coefficients[1] > 0 && coefficients[2] > 0 &&
            coefficients[3] > 0) ||
           (coefficients[0] < 0 && coefficients[1] < 0 && coefficients[2] < 0 &&
            coefficients[3] < 0);
  }
  // Computes the ends of the intervals in which it is monotonic, from 0 to 1; returns their count.
  int monotonic_bounds(std::array<double, 4>& ends) const {
    int count = 0;
    ends[static_cast<std::size_t>(count++)] = 0;
    // The derivative over 3: a + b t + c t².
    const double a = coefficients[1] - coefficients[0], m = coefficients[2] - coefficients[1],
                 z = coefficients[3] - coefficients[2];
    const double b = 2 * (m - a), c = a - 2 * m + z, discriminant = b * b - 4 * a * c;
    if (discriminant >= 0) {
      const double q = -(b + std::copysign(std::sqrt(discriminant), b)) / 2;
      double first_root = c != 0 ? q / c : -1, second_root = q != 0 ? a / q : -1;
      if (first_root > second_root) std::swap(first_root, second_root);
      for (const double t : {first_root, second_root})
        if (t > 0 && t < 1) ends[static_cast<std::size_t>(count++)] = t;
    }
    ends[static_cast<std::size_t>(count++)] = 1;
    return count;
  }
  // The root in an interval at whose ends the volume has opposite signs.
  double root(double low, double high) const {
    const bool is_rising = (*this)(low) < 0;
    for (int i = 0; i < ROOT_BISECTIONS; ++i) {
      const double middle = (low + high) / 2;
      (((*this)(middle) < 0) == is_rising ? low : high) = middle;
    }
    return (low + high) / 2;
  }

 private:
  static constexpr int ROOT_BISECTIONS = 40;
};

// Whether the bounding boxes of two elements' paths overlap; the first element has `first` of the
// four particles.
inline bool paths_overlap(const std::int32_t* particles, std::size_t first_count,
                          const double* from, const double* to) {
  for (std::size_t k = 0; k < 3; ++k) {
    double low[2], high[2];
    for (std::size_t element = 0; element < 2; ++element) {
      const std::size_t begin = element ? first_count : 0, end = element ? 4 : first_count;
      low[element] = high[element] =
          from[PARTICLE_STRIDE * static_cast<std::size_t>(particles[begin]) + k];
      for (std::size_t i = begin; i < end; ++i) {
        const std::size_t index = PARTICLE_STRIDE * static_cast<std::size_t>(particles[i]) + k;
        low[element] = std::min({low[element], from[index], to[index]});
        high[element] = std::max({high[element], from[index], to[index]});
      }
    }
    if (low[0] > high[1] || low[1] > high[0]) return false;
  }
  return true;
}

// The side (1 or -1) from which the first element has passed through the second at the end of
// linear paths; 0 if it has not: it may have gone around it, or come back.
template <class Pair>
std::int32_t passing_side(const Pair& from, const Pair& to) {
  const Volume volume(from.volume_vectors(), to.volume_vectors());
  if (volume.has_constant_sign()) return 0;
  std::array<double, 4> bounds;
  const int count = volume.monotonic_bounds(bounds);
  std::int32_t side = 0;
  for (int i = 1; i < count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const double start_volume = volume(bounds[k - 1]), end_volume = volume(bounds[k]);
    if ((start_volume >= 0) == (end_volume >= 0)) continue;
    if (from.interpolated(to, volume.root(bounds[k - 1], bounds[k])).is_projected_inside())
      side = side ? 0 : start_volume >= 0 ? 1 : -1;
  }
  return side;
}

}  // namespace animtool::shapes
