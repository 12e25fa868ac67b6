// Contacts of convex bodies: the separating axis (Gottschalk 1996, "Separating axis theorem for
// oriented bounding boxes"; edges by Gauss maps as of Gregorius 2013, "The separating axis test
// between convex polyhedra"), and points by clipping one face against another.
#include "rigid/cores.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace animtool::rigid {

namespace {

constexpr double FAR = std::numeric_limits<double>::infinity();
// Among equal axes, faces are preferred to edges, and faces of the first body to those of the
// second: by this fraction of the sizes, so that rounding does not change the points.
constexpr double PREFER = 1e-3;
// Likewise by this fraction of the depth for overlapping bodies: an edge nearly parallel to a face
// has one point, and would lose the others.
constexpr double PREFER_DEEP = 0.1;
// Squared sine below which two edges are parallel.
constexpr double PARALLEL = 1e-12;
// Tolerance of right angles between the faces of a box.
constexpr double BOX_TOLERANCE = 1e-12;
// Sine below which a segment lies on a face.
constexpr double COPLANAR = 1e-2;

struct Segment {
  Vec from, to;
};

// The nearest points of two segments: Ericson (2005), Real-Time Collision Detection, 5.1.9.
std::pair<Vec, Vec> nearest(const Segment& p, const Segment& q) {
  const Vec d = p.to - p.from, e = q.to - q.from, r = p.from - q.from;
  const double a = dot(d, d), b = dot(e, e), f = dot(e, r);
  double s = 0, t = 0;
  if (a > 0 && b > 0) {
    const double c = dot(d, r), m = dot(d, e), determinant = a * b - m * m;
    s = determinant > PARALLEL * a * b ? std::clamp((m * f - c * b) / determinant, 0.0, 1.0) : 0.0;
    t = (m * s + f) / b;
    if (t < 0 || t > 1) {
      t = std::clamp(t, 0.0, 1.0);
      s = std::clamp((m * t - c) / a, 0.0, 1.0);
    }
  } else if (a > 0) {
    s = std::clamp(-dot(d, r) / a, 0.0, 1.0);
  } else if (b > 0) {
    t = std::clamp(f / b, 0.0, 1.0);
  }
  return {p.from + d * s, q.from + e * t};
}

Vec corner(const PosedCore& p, std::size_t face, int k) {
  return p.points[p.core->loops[static_cast<std::size_t>(p.core->starts[face] + k)]];
}

int corners(const PosedCore& p, std::size_t face) {
  return p.core->starts[face + 1] - p.core->starts[face];
}

Vec along(const PosedCore& p, const Edge& e) { return p.points[e.to] - p.points[e.from]; }

// The nearest point of a face to another point.
Vec nearest_on_face(const PosedCore& p, std::size_t face, Vec at) {
  const Vec n = p.normals[face];
  const int count = corners(p, face);
  bool within = true;
  Vec best;
  double least = FAR;
  for (int k = 0; k < count; ++k) {
    const Vec a = corner(p, face, k), b = corner(p, face, (k + 1) % count), side = b - a;
    if (dot(cross(side, at - a), n) >= 0) continue;
    within = false;
    const double fraction = std::clamp(dot(at - a, side) / dot(side, side), 0.0, 1.0);
    const Vec on = a + side * fraction;
    const double squared = dot(at - on, at - on);
    if (squared < least) least = squared, best = on;
  }
  return within ? at - n * (dot(n, at) - p.offset(face)) : best;
}

// Adds contact points of a segment, or of a face clipped to the sides of another.
void clip(const PosedCore& ref, std::size_t face, std::vector<Vec>& loop, std::vector<Vec>& spare) {
  const Vec n = ref.normals[face];
  const int count = corners(ref, face);
  for (int k = 0; k < count && !loop.empty(); ++k) {
    const Vec a = corner(ref, face, k), out = cross(corner(ref, face, (k + 1) % count) - a, n);
    spare.clear();
    const std::size_t size = loop.size();
    for (std::size_t i = 0; i < size; ++i) {
      const Vec p = loop[i], q = loop[(i + 1) % size];
      const double u = dot(out, p - a), v = dot(out, q - a);
      if (u <= 0) spare.push_back(p);
      if ((u < 0 && v > 0) || (u > 0 && v < 0)) spare.push_back(p + (q - p) * (u / (u - v)));
    }
    loop.swap(spare);
  }
}

// Contact points of a reference face with the clipped face. The normal is the reference's.
void face_points(const PosedCore& ref, std::size_t face, const std::vector<Vec>& loop, double skin,
                 double ref_radius, double reach, std::vector<ContactPoint>& contact_points) {
  const Vec n = ref.normals[face];
  const double offset = ref.offset(face);
  for (Vec p : loop) {
    const double height = dot(n, p) - offset, gap = height - skin;
    if (gap > reach) continue;
    contact_points.push_back({p - n * (height - ref_radius - gap / 2), gap});
  }
}

int facing(const PosedCore& p, Vec n) {
  int best = 0;
  double least = FAR;
  for (std::size_t i = 0; i < p.core->faces(); ++i) {
    const double d = dot(p.normals[i], n);
    if (d < least) least = d, best = static_cast<int>(i);
  }
  return best;
}

struct Scratch {
  std::vector<Vec> loop, spare;
  std::vector<ContactPoint> contact_points;
};

Scratch& scratch() {
  thread_local Scratch buffer;
  return buffer;
}

Manifold face_manifold(const PosedCore& ref, const PosedCore& other, int face, bool turned,
                       double reach) {
  Scratch& buffer = scratch();
  buffer.loop.clear(), buffer.contact_points.clear();
  const Vec n = ref.normals[static_cast<std::size_t>(face)];
  const Core& core = *other.core;
  if (core.faces()) {
    const auto against = static_cast<std::size_t>(facing(other, n));
    for (int k = 0; k < corners(other, against); ++k)
      buffer.loop.push_back(corner(other, against, k));
  } else {
    buffer.loop.assign(other.points, other.points + core.points.size());
  }
  clip(ref, static_cast<std::size_t>(face), buffer.loop, buffer.spare);
  const double skin = ref.core->radius + core.radius;
  face_points(ref, static_cast<std::size_t>(face), buffer.loop, skin, ref.core->radius, reach,
              buffer.contact_points);
  Manifold manifold;
  manifold.normal = turned ? -n : n;
  reduce_to_four(buffer.contact_points, n, manifold);
  return manifold;
}

Manifold of_points(Vec a, Vec b, Vec normal, double radius_a, double radius_b) {
  Manifold manifold;
  manifold.normal = normal;
  const double gap = dot(b - a, normal) - radius_a - radius_b;
  manifold.points[0] = {a + normal * (radius_a + gap / 2), gap};
  manifold.count = 1;
  return manifold;
}

// Two without faces: spheres and capsules.
Manifold round_manifold(const PosedCore& a, const PosedCore& b, double reach) {
  const auto segment = [](const PosedCore& p) {
    return Segment{p.points[0], p.points[p.core->points.size() - 1]};
  };
  const Segment p = segment(a), q = segment(b);
  const auto [on_a, on_b] = nearest(p, q);
  const Vec off = on_b - on_a;
  const Vec d = p.to - p.from, e = q.to - q.from;
  const Vec crossed = cross(d, e);
  const double sized = dot(d, d) * dot(e, e);
  Vec sideways = direction(crossed, {0, 1, 0});
  if (!(dot(crossed, crossed) > PARALLEL * sized) && dot(d, d) > 0)
    sideways = collide::across(direction(d, {1, 0, 0}));
  const Vec normal = length(off) > 0 ? off * (1 / length(off)) : sideways;
  const double ra = a.core->radius, rb = b.core->radius;
  Manifold manifold = of_points(on_a, on_b, normal, ra, rb);
  if (manifold.points[0].gap > reach) manifold.count = 0;
  // Two parallel ones touch along a line.
  if (!manifold.count || !(sized > 0) || dot(crossed, crossed) > COPLANAR * COPLANAR * sized)
    return manifold;
  const double size = dot(d, d);
  double low = dot(q.from - p.from, d) / size, high = dot(q.to - p.from, d) / size;
  if (low > high) std::swap(low, high);
  low = std::max(low, 0.0), high = std::min(high, 1.0);
  if (!(low < high)) return manifold;
  Scratch& buffer = scratch();
  buffer.contact_points.clear();
  for (const double s : {low, high}) {
    const Vec at = p.from + d * s;
    const double t = std::clamp(dot(at - q.from, e) / dot(e, e), 0.0, 1.0);
    const double gap = dot(q.from + e * t - at, normal) - ra - rb;
    if (gap <= reach) buffer.contact_points.push_back({at + normal * (ra + gap / 2), gap});
  }
  reduce_to_four(buffer.contact_points, normal, manifold);
  return manifold;
}

// The nearest points of a core with faces and a round one, if they do not overlap.
std::pair<Vec, Vec> nearest_of(const PosedCore& solid, const PosedCore& rounded) {
  std::pair<Vec, Vec> best;
  double least = FAR;
  const auto keep_nearer = [&](Vec on, Vec off) {
    const double squared = dot(off - on, off - on);
    if (squared < least) least = squared, best = {on, off};
  };
  const std::size_t ends = rounded.core->points.size();
  for (std::size_t i = 0; i < ends; ++i) {
    const Vec at = rounded.points[i];
    for (std::size_t f = 0; f < solid.core->faces(); ++f)
      if (dot(solid.normals[f], at) > solid.offset(f))
        keep_nearer(nearest_on_face(solid, f, at), at);
  }
  if (ends > 1)
    for (const Edge& e : solid.core->edges) {
      const auto [on, off] = nearest({solid.points[e.from], solid.points[e.to]},
                                     {rounded.points[0], rounded.points[1]});
      keep_nearer(on, off);
    }
  return best;
}

Manifold meet_solid(const PosedCore& solid, const PosedCore& rounded, double reach) {
  const double skin = solid.core->radius + rounded.core->radius;
  const Axis axis = separating_axis(solid, rounded, reach + skin);
  if (axis.gap > reach + skin) return {};
  Vec normal = axis.normal;
  Vec on, off;
  if (axis.gap > 0) {
    std::tie(on, off) = nearest_of(solid, rounded);
    normal = direction(off - on, axis.normal);
    if (dot(off - on, normal) > reach + skin) return {};
  }
  const int face = axis.kind == Axis::FIRST ? axis.first : -1;
  const bool flush = face >= 0 && dot(normal, solid.normals[face]) > 1 - COPLANAR * COPLANAR / 2;
  if (rounded.core->points.size() > 1 && flush) {
    const Vec d = rounded.points[1] - rounded.points[0];
    const double tilt = dot(d, solid.normals[face]);
    if (tilt * tilt <= COPLANAR * dot(d, d)) {
      const Manifold manifold = face_manifold(solid, rounded, face, false, reach);
      if (manifold.count > 1) return manifold;
    }
  }
  if (axis.gap > 0) return of_points(on, off, normal, solid.core->radius, rounded.core->radius);
  if (axis.kind == Axis::EDGES) {
    const auto [p, q] = nearest({axis.edge_a[0], axis.edge_a[1]}, {axis.edge_b[0], axis.edge_b[1]});
    return of_points(p, q, normal, solid.core->radius, rounded.core->radius);
  }
  // Overlapping at a face: the deepest point of the round one.
  Vec deepest = rounded.points[0];
  for (std::size_t i = 1; i < rounded.core->points.size(); ++i)
    if (dot(normal, rounded.points[i]) < dot(normal, deepest)) deepest = rounded.points[i];
  const Vec below = deepest - normal * axis.gap;
  return of_points(below, deepest, normal, solid.core->radius, rounded.core->radius);
}

Manifold turned(Manifold manifold) {
  manifold.normal = -manifold.normal;
  return manifold;
}

// Whether two edges form a face of the Minkowski difference.
bool arcs_cross(Vec a, Vec b, Vec c, Vec d) {
  const Vec ba = cross(b, a), dc = cross(d, c);
  const double cba = dot(c, ba), dba = dot(d, ba), adc = dot(a, dc), bdc = dot(b, dc);
  return cba * dba < 0 && adc * bdc < 0 && cba * bdc > 0;
}

void best_face_axis(const PosedCore& a, const PosedCore& b, bool first, double slack, double reach,
                    Axis& best) {
  for (std::size_t f = 0; f < a.core->faces(); ++f) {
    const Vec n = a.normals[f];
    const double gap = b.lowest(n) - a.offset(f);
    if (gap > best.gap + slack) {
      best.gap = gap, best.normal = first ? n : -n;
      best.kind = first ? Axis::FIRST : Axis::SECOND;
      (first ? best.first : best.second) = static_cast<int>(f);
    }
    if (gap > reach) return;
  }
}

// The separating axis of two boxes, of 15 candidates, from their half extents.
Axis separating_boxes(const PosedCore& a, const PosedCore& b, double reach, double slack) {
  const Vec off = b.centre - a.centre;
  Vec axes_a[3], far[3];
  double half[3], other[3], cosines[3][3], size[3][3], at[3], along_b[3];
  for (int i = 0; i < 3; ++i) {
    const auto face = static_cast<std::size_t>(2 * i);
    axes_a[i] = a.normals[face], far[i] = b.normals[face];
    half[i] = a.core->half[i], other[i] = b.core->half[i];
    at[i] = dot(off, axes_a[i]), along_b[i] = dot(off, far[i]);
  }
  Axis best;
  const auto try_face = [&](double gap, double along, Vec n, bool first, int i) {
    if (!(gap > best.gap + (first || best.kind == Axis::NONE ? 0 : slack))) return;
    // Faces of the first face the second, and vice versa.
    best.gap = gap, best.normal = along < 0 ? -n : n;
    best.kind = first ? Axis::FIRST : Axis::SECOND;
    (first ? best.first : best.second) = 2 * i + (first ? along < 0 : along > 0);
  };
  for (int i = 0; i < 3; ++i) {
    double wide = half[i];
    for (int j = 0; j < 3; ++j) {
      cosines[i][j] = dot(axes_a[i], far[j]);
      size[i][j] = std::fabs(cosines[i][j]);
      wide += other[j] * size[i][j];
    }
    try_face(std::fabs(at[i]) - wide, at[i], axes_a[i], true, i);
    if (best.gap > reach) return best;
  }
  for (int j = 0; j < 3; ++j) {
    const double wide =
        other[j] + half[0] * size[0][j] + half[1] * size[1][j] + half[2] * size[2][j];
    try_face(std::fabs(along_b[j]) - wide, along_b[j], far[j], false, j);
    if (best.gap > reach) return best;
  }
  int edge_i = -1, edge_j = -1;
  for (int i = 0; i < 3; ++i) {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
    for (int j = 0; j < 3; ++j) {
      const double squared = 1 - cosines[i][j] * cosines[i][j];
      if (squared <= PARALLEL) continue;
      const int j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      const double wide = half[i1] * size[i2][j] + half[i2] * size[i1][j] +
                          other[j1] * size[i][j2] + other[j2] * size[i][j1];
      const double along = at[i2] * cosines[i1][j] - at[i1] * cosines[i2][j];
      const double gap = (std::fabs(along) - wide) / std::sqrt(squared);
      if (gap <= best.gap + slack + PREFER_DEEP * std::max(-best.gap, 0.0)) continue;
      best.gap = gap, best.kind = Axis::EDGES, edge_i = i, edge_j = j;
      const Vec n = direction(cross(axes_a[i], far[j]), {0, 1, 0});
      best.normal = dot(n, off) < 0 ? -n : n;
      if (gap > reach) return best;
    }
  }
  if (best.kind != Axis::EDGES) return best;
  Vec p = a.centre, q = b.centre;
  for (int k = 0; k < 3; ++k) {
    if (k != edge_i) p = p + axes_a[k] * std::copysign(half[k], dot(axes_a[k], best.normal));
    if (k != edge_j) q = q - far[k] * std::copysign(other[k], dot(far[k], best.normal));
  }
  const Vec u = axes_a[edge_i] * half[edge_i], v = far[edge_j] * other[edge_j];
  best.edge_a[0] = p - u, best.edge_a[1] = p + u;
  best.edge_b[0] = q - v, best.edge_b[1] = q + v;
  return best;
}

}  // namespace

void Core::finish() {
  normals.clear(), offsets.clear(), edges.clear();
  centre = {};
  for (Vec p : points) centre = centre + p * (1.0 / static_cast<double>(points.size()));
  std::map<std::pair<int, int>, int> sides;
  for (std::size_t f = 0; f + 1 < starts.size(); ++f) {
    Vec sum;
    const int begin = starts[f], end = starts[f + 1];
    const Vec base = points[static_cast<std::size_t>(loops[static_cast<std::size_t>(begin)])];
    const auto at = [&](int k) {
      return points[static_cast<std::size_t>(loops[static_cast<std::size_t>(k)])];
    };
    for (int k = begin + 1; k + 1 < end; ++k) sum = sum + cross(at(k) - base, at(k + 1) - base);
    const Vec n = direction(sum, {0, 1, 0});
    double offset = -FAR;
    for (int k = begin; k < end; ++k) {
      offset = std::max(offset, dot(n, at(k)));
      const int from = loops[static_cast<std::size_t>(k)];
      const int to = loops[static_cast<std::size_t>(k + 1 < end ? k + 1 : begin)];
      const auto other = sides.find({to, from});
      if (other == sides.end()) {
        sides[{from, to}] = static_cast<int>(f);
      } else {
        edges.push_back({to, from, other->second, static_cast<int>(f)});
      }
    }
    normals.push_back(n), offsets.push_back(offset);
  }
  reach = 0;
  for (Vec p : points) reach = std::max(reach, length(p));
  reach += radius;
  find_box();
}

// Six faces, in opposite pairs at right angles.
void Core::find_box() {
  box = false;
  if (normals.size() != 6 || points.size() != 8) return;
  for (std::size_t i = 0; i < 3; ++i) {
    const Vec n = normals[2 * i];
    if (dot(n, normals[2 * i + 1]) > BOX_TOLERANCE - 1) return;
    if (std::fabs(dot(n, normals[(2 * i + 2) % 6])) > BOX_TOLERANCE) return;
    half[i] = (offsets[2 * i] + offsets[2 * i + 1]) / 2;
  }
  box = true;
}

Axis separating_axis(const PosedCore& a, const PosedCore& b, double reach) {
  const double size = std::min(a.core->reach, b.core->reach);
  const double slack = PREFER * size;
  if (a.core->box && b.core->box) return separating_boxes(a, b, reach, slack);
  Axis best;
  best_face_axis(a, b, true, 0, reach, best);
  if (best.gap > reach) return best;
  best_face_axis(b, a, false, best.kind == Axis::NONE ? 0 : slack, reach, best);
  if (best.gap > reach) return best;
  const bool solid = a.core->faces() > 2 && b.core->faces() > 2;
  const auto try_edges = [&](Vec normal, double gap, Vec a0, Vec a1, Vec b0, Vec b1) {
    if (gap > best.gap + slack + PREFER_DEEP * std::max(-best.gap, 0.0))
      best = {gap, normal, Axis::EDGES, -1, -1, {a0, a1}, {b0, b1}};
  };
  if (solid) {
    for (std::size_t i = 0; i < a.core->edges.size(); ++i) {
      const Edge& e = a.core->edges[i];
      const Vec na = a.normals[e.left], nb = a.normals[e.right], u = along(a, e);
      for (std::size_t j = 0; j < b.core->edges.size(); ++j) {
        const Edge& f = b.core->edges[j];
        if (!arcs_cross(na, nb, -b.normals[f.left], -b.normals[f.right])) continue;
        const Vec v = along(b, f);
        Vec n = cross(u, v);
        const double squared = dot(n, n);
        if (squared <= PARALLEL * dot(u, u) * dot(v, v)) continue;
        n = n * (1 / std::sqrt(squared));
        if (dot(n, a.points[e.from] - a.centre) < 0) n = -n;
        try_edges(n, dot(n, b.points[f.from] - a.points[e.from]), a.points[e.from], a.points[e.to],
                  b.points[f.from], b.points[f.to]);
        if (best.gap > reach) return best;
      }
    }
    return best;
  }
  // For triangles and segments every pair of edges counts.
  const auto edge_count = [](const PosedCore& p) {
    return p.core->faces() ? p.core->edges.size() : p.core->points.size() - 1;
  };
  const auto edge_of = [](const PosedCore& p, std::size_t i) -> Segment {
    if (!p.core->faces()) return {p.points[0], p.points[1]};
    return {p.points[p.core->edges[i].from], p.points[p.core->edges[i].to]};
  };
  for (std::size_t i = 0; i < edge_count(a); ++i)
    for (std::size_t j = 0; j < edge_count(b); ++j) {
      const Segment e = edge_of(a, i), f = edge_of(b, j);
      const Vec u = e.to - e.from, v = f.to - f.from;
      Vec n = cross(u, v);
      const double squared = dot(n, n);
      if (squared <= PARALLEL * dot(u, u) * dot(v, v)) continue;
      n = n * (1 / std::sqrt(squared));
      if (dot(n, b.centre - a.centre) < 0) n = -n;
      try_edges(n, b.lowest(n) + a.lowest(-n), e.from, e.to, f.from, f.to);
      if (best.gap > reach) return best;
    }
  return best;
}

Manifold manifold_of(const PosedCore& a, const PosedCore& b, double reach) {
  if (!a.core->faces())
    return b.core->faces() ? turned(meet_solid(b, a, reach)) : round_manifold(a, b, reach);
  if (!b.core->faces()) return meet_solid(a, b, reach);
  const double skin = a.core->radius + b.core->radius;
  const Axis axis = separating_axis(a, b, reach + skin);
  if (axis.gap > reach + skin) return {};
  if (axis.kind == Axis::FIRST) return face_manifold(a, b, axis.first, false, reach);
  if (axis.kind == Axis::SECOND) return face_manifold(b, a, axis.second, true, reach);
  const auto [p, q] = nearest({axis.edge_a[0], axis.edge_a[1]}, {axis.edge_b[0], axis.edge_b[1]});
  return of_points(p, q, axis.normal, a.core->radius, b.core->radius);
}

void reduce_to_four(std::vector<ContactPoint>& points, Vec normal, Manifold& into) {
  into.count = 0;
  if (points.size() <= MAX_POINTS) {
    for (const ContactPoint& p : points) into.points[static_cast<std::size_t>(into.count++)] = p;
    return;
  }
  const auto take = [&](auto score) {
    std::size_t best = 0;
    double most = -FAR;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double s = score(points[i]);
      if (s > most) most = s, best = i;
    }
    const ContactPoint point = points[best];
    points.erase(points.begin() + static_cast<std::ptrdiff_t>(best));
    into.points[static_cast<std::size_t>(into.count++)] = point;
    return point.at;
  };
  const Vec a = take([](const ContactPoint& p) { return -p.gap; });
  const Vec b = take([&](const ContactPoint& p) { return dot(p.at - a, p.at - a); });
  const Vec side = cross(b - a, normal);
  const auto away = [&](const ContactPoint& p) { return dot(side, p.at - a); };
  const Vec c = take([&](const ContactPoint& p) { return std::fabs(away(p)); });
  const double sign = dot(side, c - a) < 0 ? -1 : 1;
  take([&](const ContactPoint& p) { return -sign * away(p); });
}

}  // namespace animtool::rigid
