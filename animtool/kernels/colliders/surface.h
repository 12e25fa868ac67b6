// Meshes whose points move while their triangles stay: the tree is built once, and its boxes
// are fitted to where the points are.
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
  // As its points go by these ways, with boxes that `fit` made.
  collide::Mesh mesh(const double* points, const double* shifts, const double* bounds) const;
  // Boxes that hold it on the whole way from one place to another.
  void fit(const double* begin, const double* end, std::vector<double>& bounds) const;

 private:
  std::size_t points_;
  std::vector<std::int32_t> triangles_, nodes_;
  collide::MeshSides sides_;
};

}  // namespace animtool
