// Signed distance to a triangle mesh by a tree of boxes. Inside and outside are told by the
// normals of faces, edges and corners: Baerentzen and Aanaes (2005), "Signed distance
// computation using the angle weighted pseudonormal".
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

#include "collide_shapes.h"

namespace animtool::collide {

// Arrays that `build_mesh_tree` makes. A node is an inner one with two children, or a leaf
// as -1 - first and a count of triangles. Edges and corners of no definite side, as on the
// rim of an open mesh, have normals of zero.
struct Mesh {
  const double* points;
  const std::int32_t* triangles;
  const double* corner_normals;
  const double* edge_normals;
  const double* bounds;
  const std::int32_t* nodes;
};

constexpr int DEEPEST = 64;

struct Nearest {
  double squared = std::numeric_limits<double>::infinity();
  Vec point;
  std::int32_t triangle = -1;
  // Corners 0 to 2, edges 3 to 5 (from corner i to the next), the face 6.
  int feature = 6;
};

// The shares that the second and third corner have of the point of a triangle nearest to
// another: Ericson (2005), Real-Time Collision Detection, 5.1.5.
struct Shares {
  double b, c;
  int feature;  // as of `Nearest`
};

inline Shares shares_of_triangle(Vec p, Vec a, Vec b, Vec c) {
  const Vec ab = b - a, ac = c - a, ap = p - a;
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return {0, 0, 0};
  const Vec bp = p - b;
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return {1, 0, 1};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return {d1 / (d1 - d3), 0, 3};
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

inline Vec nearest_on_triangle(Vec p, Vec a, Vec b, Vec c, int& feature) {
  const Shares found = shares_of_triangle(p, a, b, c);
  feature = found.feature;
  switch (feature) {
    case 0: return a;
    case 1: return b;
    case 2: return c;
    case 3: return a + (b - a) * found.b;
    case 4: return b + (c - b) * found.c;
    case 5: return a + (c - a) * found.c;
    default: return a + (b - a) * found.b + (c - a) * found.c;
  }
}

inline double squared_to_box(Vec p, const double* box) {
  const double x = std::max({box[0] - p.x, 0.0, p.x - box[3]});
  const double y = std::max({box[1] - p.y, 0.0, p.y - box[4]});
  const double z = std::max({box[2] - p.z, 0.0, p.z - box[5]});
  return x * x + y * y + z * z;
}

// The nearest point of the triangles under a node; none beyond the squared limit.
inline Nearest nearest_on_mesh(const Mesh& mesh, std::int32_t root, Vec p, double limit) {
  Nearest best;
  best.squared = limit;
  std::int32_t stack[DEEPEST];
  int depth = 0;
  stack[depth++] = root;
  while (depth > 0) {
    const std::int32_t node = stack[--depth];
    if (squared_to_box(p, mesh.bounds + 6 * node) > best.squared) continue;
    const std::int32_t left = mesh.nodes[2 * node], right = mesh.nodes[2 * node + 1];
    if (left < 0) {
      for (std::int32_t t = -1 - left; t < -1 - left + right; ++t) {
        const std::int32_t* corner = mesh.triangles + 3 * t;
        int feature = 6;
        const Vec at = nearest_on_triangle(p, load(mesh.points + 3 * corner[0]),
                                           load(mesh.points + 3 * corner[1]),
                                           load(mesh.points + 3 * corner[2]), feature);
        const double squared = dot(p - at, p - at);
        if (squared < best.squared || (best.triangle < 0 && squared <= best.squared))
          best = {squared, at, t, feature};
      }
      continue;
    }
    const bool left_first = squared_to_box(p, mesh.bounds + 6 * left) <=
                            squared_to_box(p, mesh.bounds + 6 * right);
    stack[depth++] = left_first ? right : left;
    stack[depth++] = left_first ? left : right;
  }
  return best;
}

inline Vec face_normal(const Mesh& mesh, std::int32_t triangle) {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  const Vec a = load(mesh.points + 3 * corner[0]);
  return direction(cross(load(mesh.points + 3 * corner[1]) - a,
                         load(mesh.points + 3 * corner[2]) - a),
                   {0, 1, 0});
}

// Distance and normal at a point; the reach and no normal where it is farther than that.
inline Sample sample_mesh(const Mesh& mesh, std::int32_t root, Vec p, double reach) {
  // Points behind a face are as far off as points before it.
  const Nearest near = nearest_on_mesh(mesh, root, p, reach * reach);
  if (near.triangle < 0) return {reach, {0, 1, 0}};
  const Vec face = face_normal(mesh, near.triangle);
  Vec side = face;
  if (near.feature < 3)
    side = load(mesh.corner_normals + 3 * mesh.triangles[3 * near.triangle + near.feature]);
  else if (near.feature < 6)
    side = load(mesh.edge_normals + 9 * near.triangle + 3 * (near.feature - 3));
  const Vec off = p - near.point;
  const double distance = std::sqrt(near.squared);
  const double sign = dot(off, side) < 0 ? -1 : 1;
  const Vec flat = direction(side, face);
  return {sign * distance, distance > TOUCH ? off * (sign / distance) : flat};
}

}  // namespace animtool::collide
