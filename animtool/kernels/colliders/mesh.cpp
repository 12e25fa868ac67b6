// Trees of boxes over the triangles of a mesh.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "base/checks.h"
#include "colliders/arrays.h"
#include "colliders/surface.h"

namespace animtool {

namespace {

using collide::corner_normal;
using collide::edge_normal;
using collide::MeshAdjacency;
using collide::store;

// Largest number of triangles of a leaf.
constexpr std::int32_t MAX_LEAF_TRIANGLES = 4;

struct Box {
  double low[3], high[3];
};

// A tree of boxes over the triangles of a mesh, in an order in which leaves are contiguous.
class BoxTree {
 public:
  BoxTree(const double* points, const std::int32_t* corners, std::int32_t count)
      : order_(count), boxes_(count) {
    std::iota(order_.begin(), order_.end(), 0);
    for (std::int32_t t = 0; t < count; ++t) boxes_[t] = triangle_box(points, corners + 3 * t);
    nodes.reserve(4 * count);
    bounds.reserve(12 * count);
    add_node(0, count);
  }

  const std::vector<std::int32_t>& order() const { return order_; }

  std::vector<std::int32_t> nodes;
  std::vector<double> bounds;

 private:
  static Box triangle_box(const double* points, const std::int32_t* corner) {
    Box box;
    for (int i = 0; i < 3; ++i) {
      const double a = points[3 * corner[0] + i], b = points[3 * corner[1] + i],
                   c = points[3 * corner[2] + i];
      box.low[i] = std::min({a, b, c});
      box.high[i] = std::max({a, b, c});
    }
    return box;
  }

  Box bounding_box(std::int32_t begin, std::int32_t end) const {
    Box box = boxes_[order_[begin]];
    for (std::int32_t k = begin + 1; k < end; ++k)
      for (int i = 0; i < 3; ++i) {
        box.low[i] = std::min(box.low[i], boxes_[order_[k]].low[i]);
        box.high[i] = std::max(box.high[i], boxes_[order_[k]].high[i]);
      }
    return box;
  }

  // Adds the node of some triangles. Splits them in halves along the longest side of their bounds,
  // so that the depth is bounded. Returns the node.
  std::int32_t add_node(std::int32_t begin, std::int32_t end) {
    const std::int32_t node = static_cast<std::int32_t>(nodes.size() / 2);
    const Box box = bounding_box(begin, end);
    nodes.insert(nodes.end(), {-1 - begin, end - begin});
    bounds.insert(bounds.end(), box.low, box.low + 3);
    bounds.insert(bounds.end(), box.high, box.high + 3);
    if (end - begin <= MAX_LEAF_TRIANGLES) return node;
    int axis = 0;
    for (int i = 1; i < 3; ++i)
      if (box.high[i] - box.low[i] > box.high[axis] - box.low[axis]) axis = i;
    const std::int32_t middle = begin + (end - begin) / 2;
    const auto key = [&](std::int32_t t) { return boxes_[t].low[axis] + boxes_[t].high[axis]; };
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                     [&](std::int32_t a, std::int32_t b) {
                       return key(a) < key(b) || (key(a) == key(b) && a < b);
                     });
    const std::int32_t left = add_node(begin, middle), right = add_node(middle, end);
    nodes[2 * node] = left;
    nodes[2 * node + 1] = right;
    return node;
  }

  std::vector<std::int32_t> order_;
  std::vector<Box> boxes_;
};

// A side of a triangle, by its lower and higher point.
struct TriangleSide {
  std::int32_t low, high, triangle, side;
};

std::vector<TriangleSide> sorted_sides(const std::int32_t* corners, std::int32_t count) {
  std::vector<TriangleSide> triangle_sides;
  triangle_sides.reserve(3 * count);
  for (std::int32_t t = 0; t < count; ++t)
    for (std::int32_t side = 0; side < 3; ++side) {
      const std::int32_t a = corners[3 * t + side], b = corners[3 * t + (side + 1) % 3];
      triangle_sides.push_back({std::min(a, b), std::max(a, b), t, side});
    }
  std::sort(triangle_sides.begin(), triangle_sides.end(),
            [](const TriangleSide& a, const TriangleSide& b) {
              if (a.low != b.low) return a.low < b.low;
              if (a.high != b.high) return a.high < b.high;
              return a.triangle != b.triangle ? a.triangle < b.triangle : a.side < b.side;
            });
  return triangle_sides;
}

// Numbers the edges, and marks points on the boundary.
void number_edges(const std::int32_t* corners, std::int32_t count, MeshAdjacency& adjacency) {
  const std::vector<TriangleSide> triangle_sides = sorted_sides(corners, count);
  adjacency.edges.resize(triangle_sides.size());
  for (std::size_t i = 0, end; i < triangle_sides.size(); i = end) {
    const TriangleSide& first = triangle_sides[i];
    const auto number = static_cast<std::int32_t>(adjacency.edge_starts.size());
    adjacency.edge_starts.push_back(static_cast<std::int32_t>(i));
    for (end = i; end < triangle_sides.size() && triangle_sides[end].low == first.low &&
                  triangle_sides[end].high == first.high;
         ++end) {
      adjacency.edges[3 * triangle_sides[end].triangle + triangle_sides[end].side] = number;
      adjacency.edge_triangles.push_back(triangle_sides[end].triangle);
    }
    if (end - i == 1)
      adjacency.is_boundary_point[first.low] = adjacency.is_boundary_point[first.high] = true;
  }
  adjacency.edge_starts.push_back(static_cast<std::int32_t>(triangle_sides.size()));
}

// Lists the triangle sides that start at each point.
void list_corner_sides(const std::int32_t* corners, std::int32_t count, MeshAdjacency& adjacency) {
  std::vector<std::int32_t>& starts = adjacency.corner_starts;
  for (std::int32_t k = 0; k < 3 * count; ++k) ++starts[corners[k] + 1];
  std::partial_sum(starts.begin(), starts.end(), starts.begin());
  std::vector<std::int32_t> next(starts.begin(), starts.end() - 1);
  adjacency.corner_sides.resize(3 * count);
  for (std::int32_t k = 0; k < 3 * count; ++k) adjacency.corner_sides[next[corners[k]]++] = k;
}

MeshAdjacency build_adjacency(const std::int32_t* corners, std::int32_t count, std::size_t points) {
  MeshAdjacency adjacency;
  adjacency.is_boundary_point.assign(points, false);
  adjacency.corner_starts.assign(points + 1, 0);
  number_edges(corners, count, adjacency);
  list_corner_sides(corners, count, adjacency);
  return adjacency;
}

void check_triangles(const In<double, 2>& points, const In<std::int32_t, 2>& triangles) {
  check::shape("points", points, {check::ANY, 3});
  check::shape("triangles", triangles, {check::ANY, 3});
  if (!triangles.shape(0)) check::refuse("triangles", "the array is empty");
  check::at_most("points", points.shape(0), check::MAX_ROWS);
  check::at_most("triangles", triangles.shape(0), check::MAX_ROWS);
  check::indices("triangles", triangles, 0, static_cast<std::int64_t>(points.shape(0)));
  // NaN cannot be sorted.
  check::finite("points", points);
}

}  // namespace

MeshSurface::MeshSurface(In<double, 2> points, In<std::int32_t, 2> triangles)
    : point_count_(points.shape(0)), triangles_(3 * triangles.shape(0)) {
  check_triangles(points, triangles);
  const auto count = static_cast<std::int32_t>(triangles.shape(0));
  BoxTree tree(points.data(), triangles.data(), count);
  for (std::int32_t k = 0; k < count; ++k)
    std::copy_n(triangles.data() + 3 * tree.order()[k], 3, triangles_.data() + 3 * k);
  nodes_ = std::move(tree.nodes);
  adjacency_ = build_adjacency(triangles_.data(), count, point_count_);
  built_radii_ = curvature_radii(points.data());
}

std::vector<double> MeshSurface::curvature_radii(const double* points) const {
  std::vector<double> radii(built_radii_);
  radii.resize(point_count_, collide::INF);
  const collide::Mesh current = mesh(points, nullptr, nullptr);
  for (std::int32_t t = 0; t < static_cast<std::int32_t>(triangles_.size() / 3); ++t)
    for (int side = 0; side < 3; ++side) {
      const double radius = collide::curvature_radius(current, t, side, collide::INF);
      if (radius == 0) continue;  // on the boundary
      for (const int end : {side, (side + 1) % 3}) {
        double& smallest = radii[static_cast<std::size_t>(triangles_[3 * t + end])];
        smallest = std::min(smallest, radius);
      }
    }
  return radii;
}

collide::Mesh MeshSurface::mesh(const double* points, const double* displacements,
                                const double* bounds) const {
  collide::Mesh result{points, triangles_.data(), nullptr, nullptr, bounds, nodes_.data()};
  result.displacements = displacements;
  result.adjacency = &adjacency_;
  return result;
}

void MeshSurface::fit_boxes(const double* begin, const double* end,
                            std::vector<double>& bounds) const {
  bounds.resize(3 * nodes_.size());
  // Children follow their parents.
  for (std::size_t node = nodes_.size() / 2; node-- > 0;) {
    double* box = bounds.data() + 6 * node;
    const std::int32_t left = nodes_[2 * node], right = nodes_[2 * node + 1];
    if (left >= 0) {
      const double *a = bounds.data() + 6 * left, *b = bounds.data() + 6 * right;
      for (int k = 0; k < 3; ++k) box[k] = std::min(a[k], b[k]);
      for (int k = 3; k < 6; ++k) box[k] = std::max(a[k], b[k]);
      continue;
    }
    for (int k = 0; k < 3; ++k) box[k] = HUGE_VAL, box[3 + k] = -HUGE_VAL;
    for (std::int32_t c = 3 * (-1 - left); c < 3 * (-1 - left + right); ++c)
      for (const double* positions : {begin, end})
        for (int k = 0; k < 3; ++k) {
          const double coordinate = positions[3 * triangles_[c] + k];
          box[k] = std::min(box[k], coordinate);
          box[3 + k] = std::max(box[3 + k], coordinate);
        }
  }
}

Out<double, 1> MeshSurface::distances(In<double, 2> positions, In<double, 2> points) const {
  check::numbers("positions", positions, {point_count_, 3});
  check::numbers("points", points, {check::ANY, 3});
  std::vector<double> bounds;
  fit_boxes(positions.data(), positions.data(), bounds);
  const collide::Mesh posed_mesh = mesh(positions.data(), nullptr, bounds.data());
  Out<double, 1> signed_distances(points.shape(0));
  for (std::size_t n = 0; n < points.shape(0); ++n) {
    const collide::Vec point = collide::load(points.data() + 3 * n);
    signed_distances.get()[n] = collide::sample_mesh(posed_mesh, 0, point, HUGE_VAL).distance;
  }
  return signed_distances;
}

MeshTree build_mesh_tree(In<double, 2> points, In<std::int32_t, 2> triangles) {
  check_triangles(points, triangles);
  const std::size_t point_count = points.shape(0), count = triangles.shape(0);
  Out<std::int32_t, 2> sorted_triangles(count, 3);
  Out<double, 2> corner_normals(point_count, 3);
  Out<double, 3> edge_normals(count, 3, 3);
  const std::int32_t triangle_count = static_cast<std::int32_t>(count);
  const auto tree = [&] {
    BoxTree box_tree(points.data(), triangles.data(), triangle_count);
    for (std::int32_t k = 0; k < triangle_count; ++k)
      std::copy_n(triangles.data() + 3 * box_tree.order()[k], 3, sorted_triangles.get() + 3 * k);
    const MeshAdjacency adjacency =
        build_adjacency(sorted_triangles.get(), triangle_count, point_count);
    const collide::Mesh mesh{points.data(), sorted_triangles.get(), nullptr, nullptr, nullptr,
                             nullptr};
    for (std::size_t p = 0; p < point_count; ++p)
      store(corner_normal(mesh, adjacency, static_cast<std::int32_t>(p)),
            corner_normals.get() + 3 * p);
    for (std::int32_t t = 0; t < triangle_count; ++t)
      for (int side = 0; side < 3; ++side)
        store(edge_normal(mesh, adjacency, t, side), edge_normals.get() + 9 * t + 3 * side);
    return box_tree;
  }();
  Out<double, 2> bounds(tree.bounds.size() / 6, 6);
  Out<std::int32_t, 2> nodes(tree.nodes.size() / 2, 2);
  std::copy(tree.bounds.begin(), tree.bounds.end(), bounds.get());
  std::copy(tree.nodes.begin(), tree.nodes.end(), nodes.get());
  return {std::move(sorted_triangles), std::move(corner_normals), std::move(edge_normals),
          std::move(bounds), std::move(nodes)};
}

}  // namespace animtool
