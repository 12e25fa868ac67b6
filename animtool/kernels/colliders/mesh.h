// Signed distance to a triangle mesh by a bounding volume tree. The sign comes from the normals
// of faces, edges and corners: Baerentzen and Aanaes (2005), "Signed distance computation using
// the angle weighted pseudonormal".
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <vector>

#include "colliders/shapes.h"

namespace animtool::collide {

// The triangles at each edge and at each corner of a mesh.
struct MeshAdjacency {
  std::vector<std::int32_t> edges;  // edge of each side of a triangle (T, 3)
  std::vector<std::int32_t>
      edge_starts;  // index of the first triangle of each edge in `edge_triangles` (E + 1,)
  std::vector<std::int32_t> edge_triangles;  // triangles of each edge (3 T,)
  std::vector<std::int32_t>
      corner_starts;  // index of the first side of each point in `corner_sides` (P + 1,)
  std::vector<std::int32_t>
      corner_sides;  // triangle sides that start at each point: 3 * triangle + corner (3 T,)
  std::vector<bool> is_boundary_point;  // whether a point is on the boundary (P,)
};

// Arrays that `build_mesh_tree` returns. A row of `nodes` has two children, or is a leaf: -1 minus
// its first triangle, and the number of triangles. Edges and corners without a definite side, as on
// the boundary of an open mesh, have zero normals.
struct Mesh {
  const double* points;
  const std::int32_t* triangles;
  const double* corner_normals;
  const double* edge_normals;
  const double* bounds;
  const std::int32_t* nodes;
  // For a mesh that deforms: displacements of its points, the fraction of them that is applied, and
  // the topology from which normals are computed.
  const double* displacements = nullptr;
  double fraction = 0;
  const MeshAdjacency* adjacency = nullptr;

  Vec point(std::int32_t p) const {
    const Vec position = load(points + 3 * p);
    return displacements ? position + load(displacements + 3 * p) * fraction : position;
  }
};

inline Vec min_of(Vec a, Vec b) {
  return {std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)};
}
inline Vec max_of(Vec a, Vec b) {
  return {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)};
}
// Whether boxes are at most a distance apart along each axis.
inline bool boxes_overlap(Vec low, Vec high, Vec other_low, Vec other_high, double distance) {
  return low.x <= other_high.x + distance && high.x >= other_low.x - distance &&
         low.y <= other_high.y + distance && high.y >= other_low.y - distance &&
         low.z <= other_high.z + distance && high.z >= other_low.z - distance;
}

// Size of the stack of a tree traversal.
constexpr int MAX_TREE_DEPTH = 64;

// The nearest point on a mesh, and its squared distance.
struct Nearest {
  double squared_distance = std::numeric_limits<double>::infinity();
  Vec point;
  std::int32_t triangle = -1;
  // Corners 0 to 2, edges 3 to 5 (from corner i to the next), the face 6.
  int feature = 6;
};

// Barycentric coordinates, of the second and third corner, of the point of a triangle that is
// nearest to another point: Ericson (2005), Real-Time Collision Detection, 5.1.5.
struct Barycentric {
  double b, c;
  int feature;  // see `Nearest`
};

inline Barycentric barycentric_of_nearest(Vec p, Vec a, Vec b, Vec c) {
  const Vec ab = b - a, ac = c - a, ap = p - a;
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return {0, 0, 0};
  const Vec bp = p - b;
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return {1, 0, 1};
  const double vc = d1 * d4 - d3 * d2;
  // Skips sides of zero length: the others contain the same points.
  if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) return {d1 / (d1 - d3), 0, 3};
  const Vec cp = p - c;
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return {0, 1, 2};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return {0, d2 / (d2 - d6), 5};
  const double va = d3 * d6 - d5 * d4, e = d4 - d3, f = d5 - d6;
  if (va <= 0 && e >= 0 && f >= 0) return {1 - e / (e + f), e / (e + f), 4};
  const double scale = 1 / (va + vb + vc);
  return {vb * scale, vc * scale, 6};
}

// The nearest point on a triangle, and the feature that it is on; see `Nearest`.
inline Vec nearest_on_triangle(Vec p, Vec a, Vec b, Vec c, int& feature) {
  const Barycentric hit = barycentric_of_nearest(p, a, b, c);
  feature = hit.feature;
  switch (feature) {
    case 0:
      return a;
    case 1:
      return b;
    case 2:
      return c;
    case 3:
      return a + (b - a) * hit.b;
    case 4:
      return b + (c - b) * hit.c;
    case 5:
      return a + (c - a) * hit.c;
    default:
      return a + (b - a) * hit.b + (c - a) * hit.c;
  }
}

// Squared distance of a point from a box; 0 inside.
inline double squared_box_distance(Vec p, const double* box) {
  const double x = std::max({box[0] - p.x, 0.0, p.x - box[3]});
  const double y = std::max({box[1] - p.y, 0.0, p.y - box[4]});
  const double z = std::max({box[2] - p.z, 0.0, p.z - box[5]});
  return x * x + y * y + z * z;
}

inline Nearest nearest_of_triangle(const Mesh& mesh, std::int32_t triangle, Vec p) {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  Nearest hit;
  hit.triangle = triangle;
  hit.point = nearest_on_triangle(p, mesh.point(corner[0]), mesh.point(corner[1]),
                                  mesh.point(corner[2]), hit.feature);
  hit.squared_distance = dot(p - hit.point, p - hit.point);
  return hit;
}

// Whether a triangle is nearer than the best one. Of two at the same distance the first wins, so
// that the order of traversal does not matter.
inline bool is_nearer(const Nearest& candidate, const Nearest& best) {
  if (candidate.squared_distance != best.squared_distance)
    return candidate.squared_distance < best.squared_distance;
  return best.triangle < 0 || candidate.triangle < best.triangle;
}

// Calls `visitor` for each triangle below a node whose box is within a squared distance, nearer
// boxes first. The visitor returns the new limit; `box_distance` returns the squared distance of a
// node's box.
template <class BoxDistance, class Visitor>
void visit_boxes(const Mesh& mesh, std::int32_t root, double limit, BoxDistance box_distance,
                 Visitor visitor) {
  struct QueuedNode {
    std::int32_t node;
    double box_distance;
  } stack[MAX_TREE_DEPTH];
  int depth = 0;
  stack[depth++] = {root, box_distance(root)};
  while (depth > 0) {
    const auto [node, squared_distance] = stack[--depth];
    if (squared_distance > limit) continue;
    const std::int32_t left = mesh.nodes[2 * node], right = mesh.nodes[2 * node + 1];
    if (left < 0) {
      for (std::int32_t t = -1 - left; t < -1 - left + right; ++t) limit = visitor(t);
      continue;
    }
    const QueuedNode left_node{left, box_distance(left)}, right_node{right, box_distance(right)};
    const bool is_left_nearer = left_node.box_distance <= right_node.box_distance;
    stack[depth++] = is_left_nearer ? right_node : left_node;
    stack[depth++] = is_left_nearer ? left_node : right_node;
  }
}

// Calls `visitor` for each triangle whose box is within a squared distance of a point.
template <class Visitor>
void visit_triangles(const Mesh& mesh, std::int32_t root, Vec p, double limit, Visitor visitor) {
  visit_boxes(
      mesh, root, limit,
      [&](std::int32_t node) { return squared_box_distance(p, mesh.bounds + 6 * node); }, visitor);
}

// The nearest point on the triangles below a node, if within a squared limit.
inline Nearest nearest_on_mesh(const Mesh& mesh, std::int32_t root, Vec p, double limit) {
  Nearest best;
  best.squared_distance = limit;
  visit_triangles(mesh, root, p, limit, [&](std::int32_t t) {
    const Nearest hit = nearest_of_triangle(mesh, t, p);
    if (is_nearer(hit, best)) best = hit;
    return best.squared_distance;
  });
  return best;
}

// The unit normal of a triangle; the fallback for zero area.
inline Vec face_normal(const Mesh& mesh, std::int32_t triangle, Vec fallback) {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  const Vec a = mesh.point(corner[0]);
  return direction(cross(mesh.point(corner[1]) - a, mesh.point(corner[2]) - a), fallback);
}

// The pseudonormal of an edge; zero on the boundary.
inline Vec edge_normal(const Mesh& mesh, const MeshAdjacency& adjacency, std::int32_t triangle,
                       int side) {
  const std::int32_t edge = adjacency.edges[3 * triangle + side];
  const std::int32_t begin = adjacency.edge_starts[edge], end = adjacency.edge_starts[edge + 1];
  if (end - begin == 1) return {};
  Vec sum;
  for (std::int32_t k = begin; k < end; ++k)
    sum = sum + face_normal(mesh, adjacency.edge_triangles[k], {});
  return sum;
}

// The pseudonormal of a corner, weighted by the angles of its faces; zero on the boundary.
inline Vec corner_normal(const Mesh& mesh, const MeshAdjacency& adjacency, std::int32_t point) {
  Vec sum;
  if (adjacency.is_boundary_point[point]) return sum;
  const Vec corner_point = mesh.point(point);
  for (std::int32_t k = adjacency.corner_starts[point]; k < adjacency.corner_starts[point + 1];
       ++k) {
    const std::int32_t triangle = adjacency.corner_sides[k] / 3,
                       side = adjacency.corner_sides[k] % 3;
    const std::int32_t* corner = mesh.triangles + 3 * triangle;
    const Vec a = direction(mesh.point(corner[(side + 1) % 3]) - corner_point, {});
    const Vec b = direction(mesh.point(corner[(side + 2) % 3]) - corner_point, {});
    const double angle = std::atan2(length(cross(a, b)), dot(a, b));
    sum = sum + face_normal(mesh, triangle, {}) * angle;
  }
  return sum;
}

// Angle below which neighbouring faces count as flat [rad].
constexpr double FLAT_ANGLE = 1e-3;

// Radius of curvature of a mesh at the edge of a triangle: infinite if the edge is flat or concave,
// 0 on the boundary, and at most that of faces of a given width.
inline double curvature_radius(const Mesh& mesh, std::int32_t triangle, int side,
                               double max_width) {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  const Vec a = mesh.point(corner[side]), b = mesh.point(corner[(side + 1) % 3]);
  const Vec opposite = mesh.point(corner[(side + 2) % 3]) - a, edge = b - a;
  const double squared_length = dot(edge, edge);
  if (!(squared_length > 0)) return INF;
  const Vec inward = opposite - edge * (dot(opposite, edge) / squared_length);
  const Vec sum = mesh.adjacency ? edge_normal(mesh, *mesh.adjacency, triangle, side)
                                 : load(mesh.edge_normals + 9 * triangle + 3 * side);
  if (dot(sum, sum) == 0) return 0;
  if (!(dot(sum, inward) < -FLAT_ANGLE * FLAT_ANGLE * length(inward))) return INF;
  const Vec normal = face_normal(mesh, triangle, {});
  const double angle = 2 * std::atan2(length(cross(normal, sum)), dot(normal, sum));
  return angle > FLAT_ANGLE ? std::min(length(inward), max_width) / angle : INF;
}

// The pseudonormal at the nearest point, which gives the sign of the distance.
inline Vec pseudonormal(const Mesh& mesh, const Nearest& nearest) {
  const std::int32_t t = nearest.triangle;
  if (nearest.feature < 3) {
    const std::int32_t point = mesh.triangles[3 * t + nearest.feature];
    return mesh.adjacency ? corner_normal(mesh, *mesh.adjacency, point)
                          : load(mesh.corner_normals + 3 * point);
  }
  return mesh.adjacency ? edge_normal(mesh, *mesh.adjacency, t, nearest.feature - 3)
                        : load(mesh.edge_normals + 9 * t + 3 * (nearest.feature - 3));
}

// Distance and normal at a point, from its nearest point.
inline Sample sample_nearest(const Mesh& mesh, const Nearest& nearest, Vec p) {
  const Vec triangle_normal = face_normal(mesh, nearest.triangle, {0, 1, 0});
  const Vec sign_normal = nearest.feature < 6 ? pseudonormal(mesh, nearest) : triangle_normal;
  const Vec offset = p - nearest.point;
  const double distance = std::sqrt(nearest.squared_distance);
  const double sign = dot(offset, sign_normal) < 0 ? -1 : 1;
  const Vec surface_normal = direction(sign_normal, triangle_normal);
  return {sign * distance, distance > TOUCH_DISTANCE ? offset * (sign / distance) : surface_normal};
}

// Distance and normal at a point; `max_distance` and an arbitrary normal if it is farther away.
inline Sample sample_mesh(const Mesh& mesh, std::int32_t root, Vec p, double max_distance) {
  // Points behind a face are at the same distance as points in front of it.
  const Nearest nearest = nearest_on_mesh(mesh, root, p, max_distance * max_distance);
  if (nearest.triangle < 0) return {max_distance, {0, 1, 0}};
  return sample_nearest(mesh, nearest, p);
}

// Unsigned distance, and the normal that points to the side of the point.
inline Sample unsigned_sample(const Sample& hit) {
  return hit.distance < 0 ? Sample{-hit.distance, -hit.normal} : hit;
}

// Whether a segment passes an edge of a triangle on its left. If it passes through an edge of two
// triangles, exactly one of them counts it, in spite of rounding.
inline bool passes_left(Vec a, Vec b, Vec segment, bool is_ascending) {
  const double side = dot(cross(a, b), segment);
  return side > 0 || (side == 0 && is_ascending);
}

// Whether a segment crosses a triangle.
inline bool crosses_triangle(const Mesh& mesh, std::int32_t triangle, Vec from, Vec to) {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  Vec corners[3];
  for (int k = 0; k < 3; ++k) corners[k] = mesh.point(corner[k]) - from;
  const Vec segment = to - from, normal = cross(corners[1] - corners[0], corners[2] - corners[0]);
  const double start_height = dot(corners[0], normal),
               end_height = start_height - dot(segment, normal);
  if ((start_height > 0) == (end_height > 0)) return false;
  bool is_left[3];
  for (int k = 0; k < 3; ++k) {
    const int next = (k + 1) % 3;
    is_left[k] = passes_left(corners[k], corners[next], segment, corner[k] < corner[next]);
  }
  return is_left[0] == is_left[1] && is_left[1] == is_left[2];
}

// Calls `visitor` for each triangle below a node whose box overlaps another box, in order.
template <class Visitor>
void visit_overlapping(const Mesh& mesh, std::int32_t root, Vec low, Vec high, Visitor visitor) {
  std::int32_t stack[MAX_TREE_DEPTH];
  int depth = 0;
  stack[depth++] = root;
  while (depth > 0) {
    const std::int32_t node = stack[--depth];
    const double* box = mesh.bounds + 6 * node;
    if (box[0] > high.x || box[1] > high.y || box[2] > high.z || box[3] < low.x || box[4] < low.y ||
        box[5] < low.z)
      continue;
    const std::int32_t left = mesh.nodes[2 * node], right = mesh.nodes[2 * node + 1];
    if (left >= 0)
      stack[depth++] = right, stack[depth++] = left;
    else
      for (std::int32_t t = -1 - left; t < -1 - left + right; ++t) visitor(t);
  }
}

// Whether a segment ends on the other side of a mesh: it crosses the triangles below a node an odd
// number of times.
inline bool changes_side(const Mesh& mesh, std::int32_t root, Vec from, Vec to) {
  const Vec low{std::min(from.x, to.x), std::min(from.y, to.y), std::min(from.z, to.z)};
  const Vec high{std::max(from.x, to.x), std::max(from.y, to.y), std::max(from.z, to.z)};
  bool is_changed = false;
  visit_overlapping(mesh, root, low, high,
                    [&](std::int32_t t) { is_changed ^= crosses_triangle(mesh, t, from, to); });
  return is_changed;
}

}  // namespace animtool::collide
