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

constexpr double INF = std::numeric_limits<double>::infinity();
// Among equal axes, faces are preferred to edges, and faces of the first body to those of the
// second, by this fraction of the size, so that rounding does not change the points.
constexpr double FACE_PREFERENCE_RATIO = 1e-3;
// The same as a fraction of the depth, for overlapping bodies: an edge that is nearly parallel to a
// face has only one contact point.
constexpr double DEEP_FACE_PREFERENCE_RATIO = 0.1;
// Squared sine of the angle below which two edges are parallel.
constexpr double PARALLEL_SINE_SQUARED = 1e-12;
// Tolerance of the cosine of right angles between the faces of a box.
constexpr double BOX_TOLERANCE = 1e-12;
// Sine of the angle below which a segment is parallel to a face.
constexpr double COPLANAR_SINE = 1e-2;

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
    s = determinant > PARALLEL_SINE_SQUARED * a * b
            ? std::clamp((m * f - c * b) / determinant, 0.0, 1.0)
            : 0.0;
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

// Corner k of a face, and the number of its corners.
Vec corner(const PosedCore& p, std::size_t face, int k) {
  return p.points[p.core->face_corners[static_cast<std::size_t>(p.core->face_starts[face] + k)]];
}

int corner_count(const PosedCore& p, std::size_t face) {
  return p.core->face_starts[face + 1] - p.core->face_starts[face];
}

Vec edge_vector(const PosedCore& p, const Edge& e) { return p.points[e.to] - p.points[e.from]; }

// The nearest point of a face to another point.
Vec nearest_on_face(const PosedCore& p, std::size_t face, Vec point) {
  const Vec n = p.normals[face];
  const int count = corner_count(p, face);
  bool is_inside = true;
  Vec nearest_point;
  double min_squared = INF;
  for (int k = 0; k < count; ++k) {
    const Vec a = corner(p, face, k), b = corner(p, face, (k + 1) % count), side = b - a;
    if (dot(cross(side, point - a), n) >= 0) continue;
    is_inside = false;
    const double fraction = std::clamp(dot(point - a, side) / dot(side, side), 0.0, 1.0);
    const Vec edge_point = a + side * fraction;
    const double squared_distance = dot(point - edge_point, point - edge_point);
    if (squared_distance < min_squared) min_squared = squared_distance, nearest_point = edge_point;
  }
  return is_inside ? point - n * (dot(n, point) - p.offset(face)) : nearest_point;
}

// Clips a segment or a face to the sides of a face.
void clip(const PosedCore& reference, std::size_t face, std::vector<Vec>& polygon,
          std::vector<Vec>& buffer) {
  const Vec n = reference.normals[face];
  const int count = corner_count(reference, face);
  for (int k = 0; k < count && !polygon.empty(); ++k) {
    const Vec a = corner(reference, face, k),
              outward = cross(corner(reference, face, (k + 1) % count) - a, n);
    buffer.clear();
    const std::size_t size = polygon.size();
    for (std::size_t i = 0; i < size; ++i) {
      const Vec p = polygon[i], q = polygon[(i + 1) % size];
      const double u = dot(outward, p - a), v = dot(outward, q - a);
      if (u <= 0) buffer.push_back(p);
      if ((u < 0 && v > 0) || (u > 0 && v < 0)) buffer.push_back(p + (q - p) * (u / (u - v)));
    }
    polygon.swap(buffer);
  }
}

// Contact points of a reference face with a clipped face. The normal is that of the reference.
void face_points(const PosedCore& reference, std::size_t face, const std::vector<Vec>& polygon,
                 double radius_sum, double reference_radius, double max_gap,
                 std::vector<ContactPoint>& contact_points) {
  const Vec n = reference.normals[face];
  const double offset = reference.offset(face);
  for (Vec p : polygon) {
    const double height = dot(n, p) - offset, gap = height - radius_sum;
    if (gap > max_gap) continue;
    contact_points.push_back({p - n * (height - reference_radius - gap / 2), gap});
  }
}

// The face whose normal is most opposed to a direction.
int most_opposed_face(const PosedCore& p, Vec n) {
  int best = 0;
  double min_dot = INF;
  for (std::size_t i = 0; i < p.core->face_count(); ++i) {
    const double d = dot(p.normals[i], n);
    if (d < min_dot) min_dot = d, best = static_cast<int>(i);
  }
  return best;
}

// Buffers of one thread.
struct Scratch {
  std::vector<Vec> polygon, clip_buffer;
  std::vector<ContactPoint> contact_points;
};

Scratch& scratch() {
  thread_local Scratch buffer;
  return buffer;
}

// Contact points at a face of a body; `is_flipped` if that is the second body.
Manifold face_manifold(const PosedCore& reference, const PosedCore& other, int face,
                       bool is_flipped, double max_gap) {
  Scratch& buffer = scratch();
  buffer.polygon.clear(), buffer.contact_points.clear();
  const Vec n = reference.normals[static_cast<std::size_t>(face)];
  const Core& core = *other.core;
  if (core.face_count()) {
    const auto opposed_face = static_cast<std::size_t>(most_opposed_face(other, n));
    for (int k = 0; k < corner_count(other, opposed_face); ++k)
      buffer.polygon.push_back(corner(other, opposed_face, k));
  } else {
    buffer.polygon.assign(other.points, other.points + core.points.size());
  }
  clip(reference, static_cast<std::size_t>(face), buffer.polygon, buffer.clip_buffer);
  const double radius_sum = reference.core->radius + core.radius;
  face_points(reference, static_cast<std::size_t>(face), buffer.polygon, radius_sum,
              reference.core->radius, max_gap, buffer.contact_points);
  Manifold manifold;
  manifold.normal = is_flipped ? -n : n;
  reduce_to_four(buffer.contact_points, n, manifold);
  return manifold;
}

// A manifold of one point, from the nearest points of two cores.
Manifold point_manifold(Vec a, Vec b, Vec normal, double radius_a, double radius_b) {
  Manifold manifold;
  manifold.normal = normal;
  const double gap = dot(b - a, normal) - radius_a - radius_b;
  manifold.points[0] = {a + normal * (radius_a + gap / 2), gap};
  manifold.count = 1;
  return manifold;
}

// Contacts of two cores without faces: spheres and capsules.
Manifold round_manifold(const PosedCore& a, const PosedCore& b, double max_gap) {
  const auto segment = [](const PosedCore& p) {
    return Segment{p.points[0], p.points[p.core->points.size() - 1]};
  };
  const Segment p = segment(a), q = segment(b);
  const auto [point_a, point_b] = nearest(p, q);
  const Vec offset = point_b - point_a;
  const Vec d = p.to - p.from, e = q.to - q.from;
  const Vec normal_vector = cross(d, e);
  const double squared_lengths = dot(d, d) * dot(e, e);
  Vec fallback = direction(normal_vector, {0, 1, 0});
  if (!(dot(normal_vector, normal_vector) > PARALLEL_SINE_SQUARED * squared_lengths) &&
      dot(d, d) > 0)
    fallback = collide::orthogonal(direction(d, {1, 0, 0}));
  const Vec normal = length(offset) > 0 ? offset * (1 / length(offset)) : fallback;
  const double radius_a = a.core->radius, radius_b = b.core->radius;
  Manifold manifold = point_manifold(point_a, point_b, normal, radius_a, radius_b);
  if (manifold.points[0].gap > max_gap) manifold.count = 0;
  // Parallel capsules touch along a line.
  if (!manifold.count || !(squared_lengths > 0) ||
      dot(normal_vector, normal_vector) > COPLANAR_SINE * COPLANAR_SINE * squared_lengths)
    return manifold;
  const double squared_length = dot(d, d);
  double low = dot(q.from - p.from, d) / squared_length,
         high = dot(q.to - p.from, d) / squared_length;
  if (low > high) std::swap(low, high);
  low = std::max(low, 0.0), high = std::min(high, 1.0);
  if (!(low < high)) return manifold;
  Scratch& buffer = scratch();
  buffer.contact_points.clear();
  for (const double s : {low, high}) {
    const Vec point = p.from + d * s;
    const double t = std::clamp(dot(point - q.from, e) / dot(e, e), 0.0, 1.0);
    const double gap = dot(q.from + e * t - point, normal) - radius_a - radius_b;
    if (gap <= max_gap)
      buffer.contact_points.push_back({point + normal * (radius_a + gap / 2), gap});
  }
  reduce_to_four(buffer.contact_points, normal, manifold);
  return manifold;
}

// The nearest points of a core with faces and one without, if they do not overlap.
std::pair<Vec, Vec> nearest_points(const PosedCore& faceted_core, const PosedCore& round_core) {
  std::pair<Vec, Vec> best_points;
  double min_squared = INF;
  const auto keep_nearer = [&](Vec faceted_point, Vec round_point) {
    const double squared_distance = dot(round_point - faceted_point, round_point - faceted_point);
    if (squared_distance < min_squared)
      min_squared = squared_distance, best_points = {faceted_point, round_point};
  };
  const std::size_t end_count = round_core.core->points.size();
  for (std::size_t i = 0; i < end_count; ++i) {
    const Vec point = round_core.points[i];
    for (std::size_t f = 0; f < faceted_core.core->face_count(); ++f)
      if (dot(faceted_core.normals[f], point) > faceted_core.offset(f))
        keep_nearer(nearest_on_face(faceted_core, f, point), point);
  }
  if (end_count > 1)
    for (const Edge& e : faceted_core.core->edges) {
      const auto [faceted_point, round_point] =
          nearest({faceted_core.points[e.from], faceted_core.points[e.to]},
                  {round_core.points[0], round_core.points[1]});
      keep_nearer(faceted_point, round_point);
    }
  return best_points;
}

// Contacts of a core with faces and one without.
Manifold faceted_manifold(const PosedCore& faceted_core, const PosedCore& round_core,
                          double max_gap) {
  const double radius_sum = faceted_core.core->radius + round_core.core->radius;
  const Axis axis = separating_axis(faceted_core, round_core, max_gap + radius_sum);
  if (axis.gap > max_gap + radius_sum) return {};
  Vec normal = axis.normal;
  Vec faceted_point, round_point;
  if (axis.gap > 0) {
    std::tie(faceted_point, round_point) = nearest_points(faceted_core, round_core);
    normal = direction(round_point - faceted_point, axis.normal);
    if (dot(round_point - faceted_point, normal) > max_gap + radius_sum) return {};
  }
  const int face = axis.kind == Axis::FIRST_FACE ? axis.first_face : -1;
  const bool is_flush =
      face >= 0 && dot(normal, faceted_core.normals[face]) > 1 - COPLANAR_SINE * COPLANAR_SINE / 2;
  if (round_core.core->points.size() > 1 && is_flush) {
    const Vec d = round_core.points[1] - round_core.points[0];
    const double tilt = dot(d, faceted_core.normals[face]);
    if (tilt * tilt <= COPLANAR_SINE * dot(d, d)) {
      const Manifold manifold = face_manifold(faceted_core, round_core, face, false, max_gap);
      if (manifold.count > 1) return manifold;
    }
  }
  if (axis.gap > 0)
    return point_manifold(faceted_point, round_point, normal, faceted_core.core->radius,
                          round_core.core->radius);
  if (axis.kind == Axis::EDGES) {
    const auto [p, q] = nearest({axis.edge_a[0], axis.edge_a[1]}, {axis.edge_b[0], axis.edge_b[1]});
    return point_manifold(p, q, normal, faceted_core.core->radius, round_core.core->radius);
  }
  // Overlapping at a face: takes the deepest point of the round core.
  Vec deepest = round_core.points[0];
  for (std::size_t i = 1; i < round_core.core->points.size(); ++i)
    if (dot(normal, round_core.points[i]) < dot(normal, deepest)) deepest = round_core.points[i];
  const Vec below = deepest - normal * axis.gap;
  return point_manifold(below, deepest, normal, faceted_core.core->radius, round_core.core->radius);
}

// The manifold with the bodies swapped.
Manifold flip_manifold(Manifold manifold) {
  manifold.normal = -manifold.normal;
  return manifold;
}

// Whether two edges form a face of the Minkowski difference, by the normals of the faces next to
// them.
bool arcs_cross(Vec a, Vec b, Vec c, Vec d) {
  const Vec ba = cross(b, a), dc = cross(d, c);
  const double cba = dot(c, ba), dba = dot(d, ba), adc = dot(a, dc), bdc = dot(b, dc);
  return cba * dba < 0 && adc * bdc < 0 && cba * bdc > 0;
}

// Updates the best axis with the face normals of one core.
void update_best_face_axis(const PosedCore& a, const PosedCore& b, bool is_first,
                           double preference_margin, double max_gap, Axis& best_axis) {
  for (std::size_t f = 0; f < a.core->face_count(); ++f) {
    const Vec n = a.normals[f];
    const double gap = b.min_projection(n) - a.offset(f);
    if (gap > best_axis.gap + preference_margin) {
      best_axis.gap = gap, best_axis.normal = is_first ? n : -n;
      best_axis.kind = is_first ? Axis::FIRST_FACE : Axis::SECOND_FACE;
      (is_first ? best_axis.first_face : best_axis.second_face) = static_cast<int>(f);
    }
    if (gap > max_gap) return;
  }
}

// The separating axis of two boxes, from their half extents: the best of 15 candidates.
Axis separating_boxes(const PosedCore& a, const PosedCore& b, double max_gap,
                      double preference_margin) {
  const Vec offset = b.centre - a.centre;
  Vec axes_a[3], axes_b[3];
  double half_a[3], half_b[3], cosines[3][3], abs_cosines[3][3], offset_a[3], offset_b[3];
  for (int i = 0; i < 3; ++i) {
    const auto face = static_cast<std::size_t>(2 * i);
    axes_a[i] = a.normals[face], axes_b[i] = b.normals[face];
    half_a[i] = a.core->half_extents[i], half_b[i] = b.core->half_extents[i];
    offset_a[i] = dot(offset, axes_a[i]), offset_b[i] = dot(offset, axes_b[i]);
  }
  Axis best_axis;
  const auto try_face = [&](double gap, double distance, Vec n, bool is_first, int i) {
    if (!(gap > best_axis.gap + (is_first || best_axis.kind == Axis::NONE ? 0 : preference_margin)))
      return;
    // Faces of the first body face the second, and vice versa.
    best_axis.gap = gap, best_axis.normal = distance < 0 ? -n : n;
    best_axis.kind = is_first ? Axis::FIRST_FACE : Axis::SECOND_FACE;
    (is_first ? best_axis.first_face : best_axis.second_face) =
        2 * i + (is_first ? distance < 0 : distance > 0);
  };
  for (int i = 0; i < 3; ++i) {
    double extent_sum = half_a[i];
    for (int j = 0; j < 3; ++j) {
      cosines[i][j] = dot(axes_a[i], axes_b[j]);
      abs_cosines[i][j] = std::fabs(cosines[i][j]);
      extent_sum += half_b[j] * abs_cosines[i][j];
    }
    try_face(std::fabs(offset_a[i]) - extent_sum, offset_a[i], axes_a[i], true, i);
    if (best_axis.gap > max_gap) return best_axis;
  }
  for (int j = 0; j < 3; ++j) {
    const double extent_sum = half_b[j] + half_a[0] * abs_cosines[0][j] +
                              half_a[1] * abs_cosines[1][j] + half_a[2] * abs_cosines[2][j];
    try_face(std::fabs(offset_b[j]) - extent_sum, offset_b[j], axes_b[j], false, j);
    if (best_axis.gap > max_gap) return best_axis;
  }
  int edge_i = -1, edge_j = -1;
  for (int i = 0; i < 3; ++i) {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
    for (int j = 0; j < 3; ++j) {
      const double squared_sine = 1 - cosines[i][j] * cosines[i][j];
      if (squared_sine <= PARALLEL_SINE_SQUARED) continue;
      const int j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      const double extent_sum = half_a[i1] * abs_cosines[i2][j] + half_a[i2] * abs_cosines[i1][j] +
                                half_b[j1] * abs_cosines[i][j2] + half_b[j2] * abs_cosines[i][j1];
      const double distance = offset_a[i2] * cosines[i1][j] - offset_a[i1] * cosines[i2][j];
      const double gap = (std::fabs(distance) - extent_sum) / std::sqrt(squared_sine);
      if (gap <= best_axis.gap + preference_margin +
                     DEEP_FACE_PREFERENCE_RATIO * std::max(-best_axis.gap, 0.0))
        continue;
      best_axis.gap = gap, best_axis.kind = Axis::EDGES, edge_i = i, edge_j = j;
      const Vec n = direction(cross(axes_a[i], axes_b[j]), {0, 1, 0});
      best_axis.normal = dot(n, offset) < 0 ? -n : n;
      if (gap > max_gap) return best_axis;
    }
  }
  if (best_axis.kind != Axis::EDGES) return best_axis;
  Vec p = a.centre, q = b.centre;
  for (int k = 0; k < 3; ++k) {
    if (k != edge_i) p = p + axes_a[k] * std::copysign(half_a[k], dot(axes_a[k], best_axis.normal));
    if (k != edge_j) q = q - axes_b[k] * std::copysign(half_b[k], dot(axes_b[k], best_axis.normal));
  }
  const Vec u = axes_a[edge_i] * half_a[edge_i], v = axes_b[edge_j] * half_b[edge_j];
  best_axis.edge_a[0] = p - u, best_axis.edge_a[1] = p + u;
  best_axis.edge_b[0] = q - v, best_axis.edge_b[1] = q + v;
  return best_axis;
}

}  // namespace

void Core::build_faces() {
  normals.clear(), offsets.clear(), edges.clear();
  centre = {};
  for (Vec p : points) centre = centre + p * (1.0 / static_cast<double>(points.size()));
  std::map<std::pair<int, int>, int> face_by_side;
  for (std::size_t f = 0; f + 1 < face_starts.size(); ++f) {
    Vec sum;
    const int begin = face_starts[f], end = face_starts[f + 1];
    const Vec first_corner =
        points[static_cast<std::size_t>(face_corners[static_cast<std::size_t>(begin)])];
    const auto corner_point = [&](int k) {
      return points[static_cast<std::size_t>(face_corners[static_cast<std::size_t>(k)])];
    };
    for (int k = begin + 1; k + 1 < end; ++k)
      sum = sum + cross(corner_point(k) - first_corner, corner_point(k + 1) - first_corner);
    const Vec n = direction(sum, {0, 1, 0});
    double offset = -INF;
    for (int k = begin; k < end; ++k) {
      offset = std::max(offset, dot(n, corner_point(k)));
      const int from = face_corners[static_cast<std::size_t>(k)];
      const int to = face_corners[static_cast<std::size_t>(k + 1 < end ? k + 1 : begin)];
      const auto neighbour = face_by_side.find({to, from});
      if (neighbour == face_by_side.end()) {
        face_by_side[{from, to}] = static_cast<int>(f);
      } else {
        edges.push_back({to, from, neighbour->second, static_cast<int>(f)});
      }
    }
    normals.push_back(n), offsets.push_back(offset);
  }
  bounding_radius = 0;
  for (Vec p : points) bounding_radius = std::max(bounding_radius, length(p));
  bounding_radius += radius;
  detect_box();
}

// Detects a box: six faces, in opposite pairs at right angles.
void Core::detect_box() {
  is_box = false;
  if (normals.size() != 6 || points.size() != 8) return;
  for (std::size_t i = 0; i < 3; ++i) {
    const Vec n = normals[2 * i];
    if (dot(n, normals[2 * i + 1]) > BOX_TOLERANCE - 1) return;
    if (std::fabs(dot(n, normals[(2 * i + 2) % 6])) > BOX_TOLERANCE) return;
    half_extents[i] = (offsets[2 * i] + offsets[2 * i + 1]) / 2;
  }
  is_box = true;
}

Axis separating_axis(const PosedCore& a, const PosedCore& b, double max_gap) {
  const double min_bounding_radius = std::min(a.core->bounding_radius, b.core->bounding_radius);
  const double preference_margin = FACE_PREFERENCE_RATIO * min_bounding_radius;
  if (a.core->is_box && b.core->is_box) return separating_boxes(a, b, max_gap, preference_margin);
  Axis best_axis;
  update_best_face_axis(a, b, true, 0, max_gap, best_axis);
  if (best_axis.gap > max_gap) return best_axis;
  update_best_face_axis(b, a, false, best_axis.kind == Axis::NONE ? 0 : preference_margin, max_gap,
                        best_axis);
  if (best_axis.gap > max_gap) return best_axis;
  const bool are_solid = a.core->face_count() > 2 && b.core->face_count() > 2;
  const auto try_edges = [&](Vec normal, double gap, Vec a0, Vec a1, Vec b0, Vec b1) {
    if (gap > best_axis.gap + preference_margin +
                  DEEP_FACE_PREFERENCE_RATIO * std::max(-best_axis.gap, 0.0))
      best_axis = {gap, normal, Axis::EDGES, -1, -1, {a0, a1}, {b0, b1}};
  };
  if (are_solid) {
    for (std::size_t i = 0; i < a.core->edges.size(); ++i) {
      const Edge& e = a.core->edges[i];
      const Vec na = a.normals[e.left], nb = a.normals[e.right], u = edge_vector(a, e);
      for (std::size_t j = 0; j < b.core->edges.size(); ++j) {
        const Edge& f = b.core->edges[j];
        if (!arcs_cross(na, nb, -b.normals[f.left], -b.normals[f.right])) continue;
        const Vec v = edge_vector(b, f);
        Vec n = cross(u, v);
        const double squared_length = dot(n, n);
        if (squared_length <= PARALLEL_SINE_SQUARED * dot(u, u) * dot(v, v)) continue;
        n = n * (1 / std::sqrt(squared_length));
        if (dot(n, a.points[e.from] - a.centre) < 0) n = -n;
        try_edges(n, dot(n, b.points[f.from] - a.points[e.from]), a.points[e.from], a.points[e.to],
                  b.points[f.from], b.points[f.to]);
        if (best_axis.gap > max_gap) return best_axis;
      }
    }
    return best_axis;
  }
  // For triangles and segments all pairs of edges count.
  const auto edge_count = [](const PosedCore& p) {
    return p.core->face_count() ? p.core->edges.size() : p.core->points.size() - 1;
  };
  const auto edge_of = [](const PosedCore& p, std::size_t i) -> Segment {
    if (!p.core->face_count()) return {p.points[0], p.points[1]};
    return {p.points[p.core->edges[i].from], p.points[p.core->edges[i].to]};
  };
  for (std::size_t i = 0; i < edge_count(a); ++i)
    for (std::size_t j = 0; j < edge_count(b); ++j) {
      const Segment e = edge_of(a, i), f = edge_of(b, j);
      const Vec u = e.to - e.from, v = f.to - f.from;
      Vec n = cross(u, v);
      const double squared_length = dot(n, n);
      if (squared_length <= PARALLEL_SINE_SQUARED * dot(u, u) * dot(v, v)) continue;
      n = n * (1 / std::sqrt(squared_length));
      if (dot(n, b.centre - a.centre) < 0) n = -n;
      try_edges(n, b.min_projection(n) + a.min_projection(-n), e.from, e.to, f.from, f.to);
      if (best_axis.gap > max_gap) return best_axis;
    }
  return best_axis;
}

Manifold find_manifold(const PosedCore& a, const PosedCore& b, double max_gap) {
  if (!a.core->face_count())
    return b.core->face_count() ? flip_manifold(faceted_manifold(b, a, max_gap))
                                : round_manifold(a, b, max_gap);
  if (!b.core->face_count()) return faceted_manifold(a, b, max_gap);
  const double radius_sum = a.core->radius + b.core->radius;
  const Axis axis = separating_axis(a, b, max_gap + radius_sum);
  if (axis.gap > max_gap + radius_sum) return {};
  if (axis.kind == Axis::FIRST_FACE) return face_manifold(a, b, axis.first_face, false, max_gap);
  if (axis.kind == Axis::SECOND_FACE) return face_manifold(b, a, axis.second_face, true, max_gap);
  const auto [p, q] = nearest({axis.edge_a[0], axis.edge_a[1]}, {axis.edge_b[0], axis.edge_b[1]});
  return point_manifold(p, q, axis.normal, a.core->radius, b.core->radius);
}

void reduce_to_four(std::vector<ContactPoint>& points, Vec normal, Manifold& manifold) {
  manifold.count = 0;
  if (points.size() <= MAX_MANIFOLD_POINTS) {
    for (const ContactPoint& p : points)
      manifold.points[static_cast<std::size_t>(manifold.count++)] = p;
    return;
  }
  const auto take_best = [&](auto score) {
    std::size_t best = 0;
    double best_score = -INF;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double s = score(points[i]);
      if (s > best_score) best_score = s, best = i;
    }
    const ContactPoint point = points[best];
    points.erase(points.begin() + static_cast<std::ptrdiff_t>(best));
    manifold.points[static_cast<std::size_t>(manifold.count++)] = point;
    return point.position;
  };
  const Vec a = take_best([](const ContactPoint& p) { return -p.gap; });
  const Vec b =
      take_best([&](const ContactPoint& p) { return dot(p.position - a, p.position - a); });
  const Vec perpendicular = cross(b - a, normal);
  const auto distance = [&](const ContactPoint& p) { return dot(perpendicular, p.position - a); };
  const Vec c = take_best([&](const ContactPoint& p) { return std::fabs(distance(p)); });
  const double sign = dot(perpendicular, c - a) < 0 ? -1 : 1;
  take_best([&](const ContactPoint& p) { return -sign * distance(p); });
}

}  // namespace animtool::rigid
