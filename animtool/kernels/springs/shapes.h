// Vertex-triangle and edge-edge tests: closest points, sides, and continuous crossing.
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

// Margin beyond the sides of a triangle or the ends of an edge that still counts as inside [1].
constexpr double BOUNDARY_MARGIN = 1e-6;
// Squared sine below which edges are parallel: closest at an end, and without a side.
constexpr double PARALLEL = 1e-8;
// Iterations of finding the time of a crossing, and its relative tolerance [1].
constexpr int MAX_ROOT_STEPS = 8;
constexpr double CROSSING_TOLERANCE = 1e-3;

inline Vec row_of(const double* rows, std::int32_t particle) {
  return collide::load(rows + ROW * static_cast<std::size_t>(particle));
}
inline Vec between(Vec a, Vec b, double fraction) { return a + (b - a) * fraction; }

// Closest points of two elements: the offset from the second to the first, and the weights of the
// four particles; `inside` unless an edge is closest at an end.
struct Nearest {
  Vec off;
  double fraction[4];
  bool inside = true;
};

struct Triangle {
  Vec a, b, c;

  Triangle(Vec a0, Vec b0, Vec c0) : a(a0), b(b0), c(c0) {}
  Triangle(const std::int32_t* corners, const double* rows)
      : a(row_of(rows, corners[0])), b(row_of(rows, corners[1])), c(row_of(rows, corners[2])) {}

  Nearest nearest(Vec p) const {
    const collide::Barycentric at = collide::barycentric_of_nearest(p, a, b, c);
    return {p - (a + (b - a) * at.b + (c - a) * at.c), {1, -(1 - at.b - at.c), -at.b, -at.c}};
  }
  double distance(Vec p) const { return length(nearest(p).off); }
  // Zero without area.
  Vec normal() const { return collide::direction(cross(b - a, c - a), Vec{}); }
};

struct Segment {
  Vec a, b;

  Segment(Vec a0, Vec b0) : a(a0), b(b0) {}
  Segment(const std::int32_t* ends, const double* rows)
      : a(row_of(rows, ends[0])), b(row_of(rows, ends[1])) {}

  Vec shift() const { return b - a; }
  Vec at(double fraction) const { return between(a, b, fraction); }
};

// A corner and a triangle.
struct CornerPair {
  Vec p;
  Triangle triangle;

  CornerPair(const std::int32_t* who, const double* rows)
      : p(row_of(rows, who[0])), triangle(who + 1, rows) {}
  CornerPair(Vec p0, const Triangle& t) : p(p0), triangle(t) {}

  Nearest nearest() const { return triangle.nearest(p); }
  // Towards positive heights; zero if undefined.
  Vec normal() const { return triangle.normal(); }
  double height() const { return dot(p - triangle.a, normal()); }
  CornerPair until(const CornerPair& end, double fraction) const {
    const Triangle &from = triangle, &to = end.triangle;
    return {between(p, end.p, fraction),
            {between(from.a, to.a, fraction), between(from.b, to.b, fraction),
             between(from.c, to.c, fraction)}};
  }
  // Three vectors that are coplanar when the corner is in the plane of the triangle.
  std::array<Vec, 3> spans() const {
    return {p - triangle.a, triangle.b - triangle.a, triangle.c - triangle.a};
  }
  // Whether the corner is over the triangle, along its normal.
  bool faces() const {
    const Vec ab = triangle.b - triangle.a, ac = triangle.c - triangle.a, ap = p - triangle.a;
    const double bb = dot(ab, ab), bc = dot(ab, ac), cc = dot(ac, ac);
    const double area = bb * cc - bc * bc;
    if (!(area > 0)) return false;
    const double b = (cc * dot(ap, ab) - bc * dot(ap, ac)) / area;
    const double c = (bb * dot(ap, ac) - bc * dot(ap, ab)) / area;
    return b >= -BOUNDARY_MARGIN && c >= -BOUNDARY_MARGIN && b + c <= 1 + BOUNDARY_MARGIN;
  }
};

// Two edges.
struct EdgePair {
  Segment first, second;

  EdgePair(const std::int32_t* who, const double* rows) : first(who, rows), second(who + 2, rows) {}
  EdgePair(const Segment& one, const Segment& other) : first(one), second(other) {}

  Nearest nearest() const {
    const Vec d = first.shift(), e = second.shift(), r = first.a - second.a;
    const double dd = dot(d, d), ee = dot(e, e), de = dot(d, e), dr = dot(d, r), er = dot(e, r);
    const double area = dd * ee - de * de;
    double s = 0, t = 0;
    bool inside = area > PARALLEL * dd * ee;
    if (inside) s = (de * er - ee * dr) / area;
    inside = inside && s > 0 && s < 1;
    s = std::clamp(s, 0.0, 1.0);
    if (ee > 0) t = (de * s + er) / ee;
    if (!(t > 0 && t < 1)) {
      inside = false;
      t = std::clamp(t, 0.0, 1.0);
      s = dd > 0 ? std::clamp((de * t - dr) / dd, 0.0, 1.0) : 0.0;
    }
    return {first.at(s) - second.at(t), {1 - s, s, -(1 - t), -t}, inside};
  }
  Vec normal() const {
    const Vec d = first.shift(), e = second.shift(), n = cross(d, e);
    return dot(n, n) > PARALLEL * dot(d, d) * dot(e, e) ? collide::direction(n, Vec{}) : Vec{};
  }
  double height() const { return dot(first.a - second.a, normal()); }
  EdgePair until(const EdgePair& end, double fraction) const {
    const auto one = [fraction](const Segment& from, const Segment& to) {
      return Segment(between(from.a, to.a, fraction), between(from.b, to.b, fraction));
    };
    return {one(first, end.first), one(second, end.second)};
  }
  // Three vectors that are coplanar when the edges are.
  std::array<Vec, 3> spans() const { return {first.a - second.a, first.shift(), second.shift()}; }
  // Whether the lines are nearest at points of both edges.
  bool faces() const {
    const Vec d = first.shift(), e = second.shift(), r = first.a - second.a;
    const double dd = dot(d, d), ee = dot(e, e), de = dot(d, e);
    const double area = dd * ee - de * de;
    if (!(area > PARALLEL * dd * ee)) return false;
    const double s = (de * dot(e, r) - ee * dot(d, r)) / area;
    const double t = (dd * dot(e, r) - de * dot(d, r)) / area;
    return s >= -BOUNDARY_MARGIN && s <= 1 + BOUNDARY_MARGIN && t >= -BOUNDARY_MARGIN &&
           t <= 1 + BOUNDARY_MARGIN;
  }
};

// The side (1 or -1) from which the first passes through the second on linear paths; 0 if it does
// not. If only the normal flips, they never meet.
template <class Pair>
std::int32_t crossed_from(const Pair& from, const Pair& to) {
  const double first = from.height(), last = to.height();
  if ((first >= 0) == (last >= 0) || !(std::abs(first - last) > 0)) return 0;
  double low = 0, high = 1, below = first, above = last;
  for (int i = 0; i < MAX_ROOT_STEPS; ++i) {
    const double fraction = low + (high - low) * below / (below - above);
    const Pair then = from.until(to, fraction);
    const double height = then.height();
    if (std::abs(height) <= CROSSING_TOLERANCE * std::abs(first - last))
      return !then.faces() ? 0 : first >= 0 ? 1 : -1;
    if ((height >= 0) == (first >= 0))
      low = fraction, below = height, above /= 2;
    else
      high = fraction, above = height, below /= 2;
  }
  return 0;
}

// The volume spanned by three vectors that change linearly: a cubic in the fraction, in Bernstein
// form.
struct Volume {
  double at[4];

  Volume(const std::array<Vec, 3>& from, const std::array<Vec, 3>& to) {
    const auto of = [](Vec a, Vec b, Vec c) { return dot(a, cross(b, c)); };
    const auto& [a, b, c] = from;
    const auto& [u, v, w] = to;
    at[0] = of(a, b, c);
    at[1] = (of(u, b, c) + of(a, v, c) + of(a, b, w)) / 3;
    at[2] = (of(u, v, c) + of(u, b, w) + of(a, v, w)) / 3;
    at[3] = of(u, v, w);
  }
  double operator()(double t) const {
    const double s = 1 - t;
    return s * s * (s * at[0] + 3 * t * at[1]) + t * t * (3 * s * at[2] + t * at[3]);
  }
  bool keeps_sign() const {
    return (at[0] > 0 && at[1] > 0 && at[2] > 0 && at[3] > 0) ||
           (at[0] < 0 && at[1] < 0 && at[2] < 0 && at[3] < 0);
  }
  // Bounds of the monotonic intervals, ends included; returns their count.
  int bounds(std::array<double, 4>& hit) const {
    int count = 0;
    hit[static_cast<std::size_t>(count++)] = 0;
    // Its derivative over 3: a + b t + c t².
    const double a = at[1] - at[0], m = at[2] - at[1], z = at[3] - at[2];
    const double b = 2 * (m - a), c = a - 2 * m + z, square = b * b - 4 * a * c;
    if (square >= 0) {
      const double q = -(b + std::copysign(std::sqrt(square), b)) / 2;
      double one = c != 0 ? q / c : -1, other = q != 0 ? a / q : -1;
      if (one > other) std::swap(one, other);
      for (const double t : {one, other})
        if (t > 0 && t < 1) hit[static_cast<std::size_t>(count++)] = t;
    }
    hit[static_cast<std::size_t>(count++)] = 1;
    return count;
  }
  // The root between two fractions of opposite sign.
  double root(double low, double high) const {
    const bool rises = (*this)(low) < 0;
    for (int i = 0; i < HALVINGS; ++i) {
      const double middle = (low + high) / 2;
      (((*this)(middle) < 0) == rises ? low : high) = middle;
    }
    return (low + high) / 2;
  }

 private:
  static constexpr int HALVINGS = 40;
};

// Whether the bounding boxes of the paths of the first particles and of the others overlap.
inline bool paths_overlap(const std::int32_t* who, std::size_t first, const double* from,
                          const double* to) {
  for (std::size_t k = 0; k < 3; ++k) {
    double low[2], high[2];
    for (std::size_t side = 0; side < 2; ++side) {
      const std::size_t begin = side ? first : 0, end = side ? 4 : first;
      low[side] = high[side] = from[ROW * static_cast<std::size_t>(who[begin]) + k];
      for (std::size_t i = begin; i < end; ++i) {
        const std::size_t at = ROW * static_cast<std::size_t>(who[i]) + k;
        low[side] = std::min({low[side], from[at], to[at]});
        high[side] = std::max({high[side], from[at], to[at]});
      }
    }
    if (low[0] > high[1] || low[1] > high[0]) return false;
  }
  return true;
}

// The side (1 or -1) from which the first has pierced the second at the end of linear paths, 0 if
// it has not: it may have gone around, or come back.
template <class Pair>
std::int32_t passed_from(const Pair& from, const Pair& to) {
  const Volume volume(from.spans(), to.spans());
  if (volume.keeps_sign()) return 0;
  std::array<double, 4> bounds;
  const int count = volume.bounds(bounds);
  std::int32_t side = 0;
  for (int i = 1; i < count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const double first = volume(bounds[k - 1]), last = volume(bounds[k]);
    if ((first >= 0) == (last >= 0)) continue;
    if (from.until(to, volume.root(bounds[k - 1], bounds[k])).faces())
      side = side ? 0 : first >= 0 ? 1 : -1;
  }
  return side;
}

}  // namespace animtool::shapes
