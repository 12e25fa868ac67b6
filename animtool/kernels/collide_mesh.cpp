// Trees of boxes over the triangles of a mesh.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "collide_mesh.h"
#include "kernels.h"

namespace animtool {

namespace {

using collide::Vec;
using collide::cross;
using collide::direction;
using collide::dot;
using collide::length;
using collide::load;
using collide::store;

constexpr std::int32_t LEAF = 4;

struct Box {
  double low[3], high[3];
};

class Tree {
 public:
  Tree(const double* points, const std::int32_t* corners, std::int32_t count)
      : order_(count), boxes_(count) {
    std::iota(order_.begin(), order_.end(), 0);
    for (std::int32_t t = 0; t < count; ++t) boxes_[t] = box_of(points, corners + 3 * t);
    nodes.reserve(4 * count);
    bounds.reserve(12 * count);
    split(0, count);
  }

  const std::vector<std::int32_t>& order() const { return order_; }

  std::vector<std::int32_t> nodes;
  std::vector<double> bounds;

 private:
  static Box box_of(const double* points, const std::int32_t* corner) {
    Box box;
    for (int i = 0; i < 3; ++i) {
      const double a = points[3 * corner[0] + i], b = points[3 * corner[1] + i],
                   c = points[3 * corner[2] + i];
      box.low[i] = std::min({a, b, c});
      box.high[i] = std::max({a, b, c});
    }
    return box;
  }

  Box around(std::int32_t begin, std::int32_t end) const {
    Box box = boxes_[order_[begin]];
    for (std::int32_t k = begin + 1; k < end; ++k)
      for (int i = 0; i < 3; ++i) {
        box.low[i] = std::min(box.low[i], boxes_[order_[k]].low[i]);
        box.high[i] = std::max(box.high[i], boxes_[order_[k]].high[i]);
      }
    return box;
  }

  // Halves the triangles along the longest side, so that the depth is bounded.
  std::int32_t split(std::int32_t begin, std::int32_t end) {
    const std::int32_t node = static_cast<std::int32_t>(nodes.size() / 2);
    const Box box = around(begin, end);
    nodes.insert(nodes.end(), {-1 - begin, end - begin});
    bounds.insert(bounds.end(), box.low, box.low + 3);
    bounds.insert(bounds.end(), box.high, box.high + 3);
    if (end - begin <= LEAF) return node;
    int axis = 0;
    for (int i = 1; i < 3; ++i)
      if (box.high[i] - box.low[i] > box.high[axis] - box.low[axis]) axis = i;
    const std::int32_t middle = begin + (end - begin) / 2;
    const auto key = [&](std::int32_t t) { return boxes_[t].low[axis] + boxes_[t].high[axis]; };
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                     [&](std::int32_t a, std::int32_t b) {
                       return key(a) < key(b) || (key(a) == key(b) && a < b);
                     });
    const std::int32_t left = split(begin, middle), right = split(middle, end);
    nodes[2 * node] = left;
    nodes[2 * node + 1] = right;
    return node;
  }

  std::vector<std::int32_t> order_;
  std::vector<Box> boxes_;
};

struct Edge {
  std::int32_t low, high, triangle, side;
};

std::vector<Edge> edges_of(const std::int32_t* corners, std::int32_t count) {
  std::vector<Edge> edges;
  edges.reserve(3 * count);
  for (std::int32_t t = 0; t < count; ++t)
    for (std::int32_t side = 0; side < 3; ++side) {
      const std::int32_t a = corners[3 * t + side], b = corners[3 * t + (side + 1) % 3];
      edges.push_back({std::min(a, b), std::max(a, b), t, side});
    }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) {
    if (a.low != b.low) return a.low < b.low;
    if (a.high != b.high) return a.high < b.high;
    return a.triangle != b.triangle ? a.triangle < b.triangle : a.side < b.side;
  });
  return edges;
}

Vec face_of(const double* points, const std::int32_t* corner) {
  const Vec a = load(points + 3 * corner[0]);
  return direction(
      cross(load(points + 3 * corner[1]) - a, load(points + 3 * corner[2]) - a), {});
}

// Normals of edges, and of corners by the angles of their faces; zero on the rim.
void side_normals(const double* points, const std::int32_t* corners, std::int32_t count,
                  std::size_t point_count, double* corner_normals, double* edge_normals) {
  std::vector<bool> rim(point_count, false);
  std::fill_n(corner_normals, 3 * point_count, 0.0);
  const std::vector<Edge> edges = edges_of(corners, count);
  for (std::size_t i = 0, end; i < edges.size(); i = end) {
    Vec sum;
    for (end = i; end < edges.size() && edges[end].low == edges[i].low &&
                  edges[end].high == edges[i].high; ++end)
      sum = sum + face_of(points, corners + 3 * edges[end].triangle);
    if (end - i == 1) rim[edges[i].low] = rim[edges[i].high] = true, sum = {};
    for (std::size_t k = i; k < end; ++k)
      store(sum, edge_normals + 9 * edges[k].triangle + 3 * edges[k].side);
  }
  for (std::int32_t t = 0; t < count; ++t)
    for (int side = 0; side < 3; ++side) {
      const std::int32_t* corner = corners + 3 * t;
      const Vec at = load(points + 3 * corner[side]);
      const Vec a = direction(load(points + 3 * corner[(side + 1) % 3]) - at, {});
      const Vec b = direction(load(points + 3 * corner[(side + 2) % 3]) - at, {});
      double* normal = corner_normals + 3 * corner[side];
      const double angle = std::atan2(length(cross(a, b)), dot(a, b));
      store(load(normal) + face_of(points, corner) * angle, normal);
    }
  for (std::size_t p = 0; p < point_count; ++p)
    if (rim[p]) store({}, corner_normals + 3 * p);
}

}  // namespace

MeshTree build_mesh_tree(In<double, 2> points, In<std::int32_t, 2> triangles) {
  const std::size_t point_count = points.shape(0), count = triangles.shape(0);
  if (points.shape(1) != 3 || triangles.shape(1) != 3 || count == 0)
    throw std::invalid_argument("points are (P, 3), triangles are (T, 3), at least one");
  for (std::size_t i = 0; i < 3 * count; ++i)
    if (triangles.data()[i] < 0 ||
        triangles.data()[i] >= static_cast<std::int64_t>(point_count))
      throw std::invalid_argument("corners of triangles are points");
  Buffer<std::int32_t> sorted(3 * count);
  Buffer<double> corner_normals(3 * point_count), edge_normals(9 * count);
  const std::int32_t rows = static_cast<std::int32_t>(count);
  const auto tree = [&] {
    nb::gil_scoped_release release;
    Tree made(points.data(), triangles.data(), rows);
    for (std::int32_t k = 0; k < rows; ++k)
      std::copy_n(triangles.data() + 3 * made.order()[k], 3, sorted.get() + 3 * k);
    side_normals(points.data(), sorted.get(), rows, point_count, corner_normals.get(),
                 edge_normals.get());
    return made;
  }();
  Buffer<double> bounds(tree.bounds.size());
  Buffer<std::int32_t> nodes(tree.nodes.size());
  std::copy(tree.bounds.begin(), tree.bounds.end(), bounds.get());
  std::copy(tree.nodes.begin(), tree.nodes.end(), nodes.get());
  const std::size_t by_point[2] = {point_count, 3}, by_triangle[2] = {count, 3},
                    by_edge[3] = {count, 3, 3}, by_bound[2] = {tree.bounds.size() / 6, 6},
                    by_node[2] = {tree.nodes.size() / 2, 2};
  return {sorted.release(by_triangle), corner_normals.release(by_point),
          edge_normals.release(by_edge), bounds.release(by_bound), nodes.release(by_node)};
}

}  // namespace animtool
