// Meshes whose points move but whose triangles stay the same: the tree is built once, and its
// boxes are refitted to the points.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/arrays.h"
#include "colliders/mesh.h"

namespace animtool {

// A mesh whose points move and whose triangles stay.
class MeshSurface {
 public:
  MeshSurface(In<double, 2> points, In<std::int32_t, 2> triangles);

  std::size_t point_count() const { return point_count_; }
  // The mesh with points that move by these displacements, with boxes from `fit_boxes`.
  collide::Mesh mesh(const double* points, const double* displacements, const double* bounds) const;
  // Computes boxes that contain the triangles along their motion between two sets of positions.
  void fit_boxes(const double* begin, const double* end, std::vector<double>& bounds) const;
  // The smallest radius of curvature at the edges of each point, at these points (P, 3) or when the
  // mesh was built; infinite where it is flat, concave or open (P,).
  std::vector<double> curvature_radii(const double* points) const;
  // Signed distances of points from the mesh, with the mesh points at `positions`.
  Out<double, 1> distances(In<double, 2> positions, In<double, 2> points) const;

 private:
  std::size_t point_count_;
  std::vector<std::int32_t> triangles_, nodes_;
  collide::MeshAdjacency adjacency_;
  std::vector<double> built_radii_;
};

}  // namespace animtool
