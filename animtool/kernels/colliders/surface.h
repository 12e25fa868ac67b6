// Meshes whose points move but whose triangles stay the same: the tree is built once, and its
// boxes are refitted to the points.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/arrays.h"
#include "colliders/mesh.h"

namespace animtool {

class MeshSurface {
 public:
  MeshSurface(In<double, 2> points, In<std::int32_t, 2> triangles);

  std::size_t points() const { return points_; }
  // The mesh with its points moving by these displacements, with boxes from `fit`.
  collide::Mesh mesh(const double* points, const double* shifts, const double* bounds) const;
  // Boxes that contain it along the whole way from one set of positions to another.
  void fit(const double* begin, const double* end, std::vector<double>& bounds) const;

 private:
  std::size_t points_;
  std::vector<std::int32_t> triangles_, nodes_;
  collide::MeshAdjacency sides_;
};

}  // namespace animtool
