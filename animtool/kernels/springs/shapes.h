// Corners against triangles and edges against edges: where they are nearest, on which side
// of each other they are, and whether they went through each other.
//
// C. Ericson, Real-Time Collision Detection, 2005, 5.1.5 and 5.1.9; R. Bridson et al., Robust
// Treatment of Collisions, Contact and Friction for Cloth Animation, 2002, 6.1.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "colliders/mesh.h"
#include "springs/rows.h"

namespace animtool::shapes {

using collide::Vec;

// Beyond the sides of a triangle or the ends of an edge, what still counts as through it [1].
constexpr double BRIM = 1e-6;
// The square of the sine of an angle between edges, below which they are parallel: nearest
// at an end of one, and on no side of each other.
constexpr double PARALLEL = 1e-8;
// The moment of a crossing is looked for so often, up to this of the way through [1].
constexpr int MOST_LOOKS = 8;
constexpr double MET = 1e-3;

inline Vec row_of(const double* rows, std::int32_t particle) {
  return collide::load(rows + ROW * static_cast<std::size_t>(particle));
}
inline Vec between(Vec a, Vec b, double share) { return a + (b - a) * share; }

// Where two of them are nearest: from the second to the first, and the shares of the four
// particles in that; inside is not at an end of an edge.
struct Nearest {
  Vec off;
  double share[4];
  bool inside = true;
};

struct Triangle {
  Vec a, b, c;

  Triangle(Vec a0, Vec b0, Vec c0) : a(a0), b(b0), c(c0) {}
  Triangle(const std::int32_t* corners, const double* rows)
      : a(row_of(rows, corners[0])), b(row_of(rows, corners[1])), c(row_of(rows, corners[2])) {}

  Nearest nearest(Vec p) const {
    const collide::Shares at = collide::shares_of_triangle(p, a, b, c);
    return {p - (a + (b - a) * at.b + (c - a) * at.c), {1, -(1 - at.b - at.c), -at.b, -at.c}};
  }
  double distance(Vec p) const { return length(nearest(p).off); }
  // Of no length where it has no area.
  Vec normal() const { return collide::direction(cross(b - a, c - a), Vec{}); }
};

struct Segment {
  Vec a, b;

  Segment(Vec a0, Vec b0) : a(a0), b(b0) {}
  Segment(const std::int32_t* ends, const double* rows)
      : a(row_of(rows, ends[0])), b(row_of(rows, ends[1])) {}

  Vec way() const { return b - a; }
  Vec at(double share) const { return between(a, b, share); }
};

// A corner and a triangle, somewhere.
struct CornerPair {
  Vec p;
  Triangle triangle;

  CornerPair(const std::int32_t* who, const double* rows)
      : p(row_of(rows, who[0])), triangle(who + 1, rows) {}
  CornerPair(Vec p0, const Triangle& t) : p(p0), triangle(t) {}

  Nearest nearest() const { return triangle.nearest(p); }
  // Towards the side that heights above 0 are on; of no length where there is none.
  Vec normal() const { return triangle.normal(); }
  double height() const { return dot(p - triangle.a, normal()); }
  CornerPair until(const CornerPair& end, double share) const {
    const Triangle &from = triangle, &to = end.triangle;
    return {between(p, end.p, share), {between(from.a, to.a, share), between(from.b, to.b, share),
                                       between(from.c, to.c, share)}};
  }
  // Whether the corner is over the triangle, along its normal.
  bool faces() const {
    const Vec ab = triangle.b - triangle.a, ac = triangle.c - triangle.a, ap = p - triangle.a;
    const double bb = dot(ab, ab), bc = dot(ab, ac), cc = dot(ac, ac);
    const double area = bb * cc - bc * bc;
    if (!(area > 0)) return false;
    const double b = (cc * dot(ap, ab) - bc * dot(ap, ac)) / area;
    const double c = (bb * dot(ap, ac) - bc * dot(ap, ab)) / area;
    return b >= -BRIM && c >= -BRIM && b + c <= 1 + BRIM;
  }
};

// Two edges, somewhere.
struct EdgePair {
  Segment first, second;

  EdgePair(const std::int32_t* who, const double* rows)
      : first(who, rows), second(who + 2, rows) {}
  EdgePair(const Segment& one, const Segment& other) : first(one), second(other) {}

  Nearest nearest() const {
    const Vec d = first.way(), e = second.way(), r = first.a - second.a;
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
    const Vec d = first.way(), e = second.way(), n = cross(d, e);
    return dot(n, n) > PARALLEL * dot(d, d) * dot(e, e) ? collide::direction(n, Vec{}) : Vec{};
  }
  double height() const { return dot(first.a - second.a, normal()); }
  EdgePair until(const EdgePair& end, double share) const {
    const auto one = [share](const Segment& from, const Segment& to) {
      return Segment(between(from.a, to.a, share), between(from.b, to.b, share));
    };
    return {one(first, end.first), one(second, end.second)};
  }
  // Whether the lines are nearest at points of both edges.
  bool faces() const {
    const Vec d = first.way(), e = second.way(), r = first.a - second.a;
    const double dd = dot(d, d), ee = dot(e, e), de = dot(d, e);
    const double area = dd * ee - de * de;
    if (!(area > PARALLEL * dd * ee)) return false;
    const double s = (de * dot(e, r) - ee * dot(d, r)) / area;
    const double t = (dd * dot(e, r) - de * dot(d, r)) / area;
    return s >= -BRIM && s <= 1 + BRIM && t >= -BRIM && t <= 1 + BRIM;
  }
};

// From which side (1 or -1) the first went through the second, all on straight ways; 0 where
// it did not. Where only the normal turned over, no moment has them at one place.
template <class Pair>
std::int32_t crossed_from(const Pair& from, const Pair& to) {
  const double first = from.height(), last = to.height();
  if ((first >= 0) == (last >= 0) || !(std::abs(first - last) > 0)) return 0;
  double low = 0, high = 1, below = first, above = last;
  for (int i = 0; i < MOST_LOOKS; ++i) {
    const double share = low + (high - low) * below / (below - above);
    const Pair then = from.until(to, share);
    const double height = then.height();
    if (std::abs(height) <= MET * std::abs(first - last))
      return !then.faces() ? 0 : first >= 0 ? 1 : -1;
    if ((height >= 0) == (first >= 0))
      low = share, below = height, above /= 2;
    else
      high = share, above = height, below /= 2;
  }
  return 0;
}

}  // namespace animtool::shapes
