// Convex shapes of rigid bodies: a core of points, and a rounding radius.
#pragma once

#include <array>
#include <limits>
#include <vector>

#include "base/poses.h"

namespace animtool::rigid {

using collide::direction;
using collide::length;
using collide::Pose;
using collide::Vec;

struct Edge {
  int from, to;     // points
  int left, right;  // faces on both sides
};

// A sphere has one point, a capsule two, both without faces; a triangle has two faces.
struct Core {
  std::vector<Vec> points;
  std::vector<int> starts{0}, loops;  // corners of each face, counter-clockwise from outside
  std::vector<Vec> normals;
  std::vector<double> offsets;
  std::vector<Edge> edges;
  double radius = 0;
  bool box = false;            // a box: faces in opposite pairs at right angles
  double half[3] = {0, 0, 0};  // half extents
  double reach = 0;            // distance of the farthest point from the origin, with the radius
  Vec centre;

  std::size_t faces() const { return normals.size(); }
  bool flat() const { return normals.size() == 2; }
  void finish();

 private:
  void find_box();
};

// A posed core: its points and face normals in the world.
struct PosedCore {
  const Core* core = nullptr;
  const Vec* points = nullptr;
  const Vec* normals = nullptr;
  Vec centre;

  double offset(std::size_t face) const {
    return dot(normals[face], points[core->loops[static_cast<std::size_t>(core->starts[face])]]);
  }
  double lowest(Vec n) const {
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < core->points.size(); ++i)
      least = std::min(least, dot(n, points[i]));
    return least;
  }
};

// A core placed by a pose, with its buffers.
class CorePoser {
 public:
  void set(const Core& core, const Pose& pose) {
    const std::size_t points = core.points.size(), faces = core.faces();
    buffer_.resize(points + faces);
    for (std::size_t i = 0; i < points; ++i) buffer_[i] = pose.to_world(core.points[i]);
    for (std::size_t i = 0; i < faces; ++i) buffer_[points + i] = pose.rotated(core.normals[i]);
    placed_ = {&core, buffer_.data(), buffer_.data() + points, pose.to_world(core.centre)};
  }
  const PosedCore& get() const { return placed_; }

 private:
  std::vector<Vec> buffer_;
  PosedCore placed_;
};

// A contact point, halfway between both surfaces, and the gap there.
struct ContactPoint {
  Vec at;
  double gap;
};

constexpr int MAX_POINTS = 4;

// A contact manifold: the normal is from the first to the second.
struct Manifold {
  Vec normal;
  int count = 0;
  std::array<ContactPoint, MAX_POINTS> points{};
};

// The separation along the best axis, negative if they overlap; at most their distance. Stops
// early, with infinity, beyond a limit.
struct Axis {
  double gap = -std::numeric_limits<double>::infinity();
  Vec normal;  // from the first to the second
  enum { NONE, FIRST, SECOND, EDGES } kind = NONE;
  int first = -1, second = -1;  // faces
  Vec edge_a[2], edge_b[2];     // ends of edges
};

Axis separating_axis(const PosedCore& a, const PosedCore& b, double reach);

// The contact of two within a distance; no points beyond it.
Manifold manifold_of(const PosedCore& a, const PosedCore& b, double reach);

// Reduces contact points to the four that matter most, starting at the deepest.
void reduce_to_four(std::vector<ContactPoint>& points, Vec normal, Manifold& into);

}  // namespace animtool::rigid
