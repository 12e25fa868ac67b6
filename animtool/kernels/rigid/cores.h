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

// An edge between two points, and the faces next to it.
struct Edge {
  int from, to;     // points
  int left, right;  // faces on the left and on the right
};

// A convex core. A sphere has one point and a capsule two, both without faces; a triangle has two
// faces.
struct Core {
  std::vector<Vec> points;
  std::vector<int> face_starts{0},
      face_corners;  // corners of each face, counter-clockwise from outside
  std::vector<Vec> normals;
  std::vector<double> offsets;
  std::vector<Edge> edges;
  double radius = 0;
  bool is_box = false;                 // six faces in opposite pairs at right angles
  double half_extents[3] = {0, 0, 0};  // of a box
  double bounding_radius = 0;  // distance of the farthest point from the origin, plus the radius
  Vec centre;

  std::size_t face_count() const { return normals.size(); }
  bool is_flat() const { return normals.size() == 2; }
  // Computes the normals, edges and bounds from the points and loops.
  void build_faces();

 private:
  void detect_box();
};

// A posed core: its points and face normals in the world.
struct PosedCore {
  const Core* core = nullptr;
  const Vec* points = nullptr;
  const Vec* normals = nullptr;
  Vec centre;

  double offset(std::size_t face) const {
    return dot(normals[face],
               points[core->face_corners[static_cast<std::size_t>(core->face_starts[face])]]);
  }
  // Smallest component of a point along a direction.
  double min_projection(Vec n) const {
    double smallest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < core->points.size(); ++i)
      smallest = std::min(smallest, dot(n, points[i]));
    return smallest;
  }
};

// Poses a core, with its buffers.
class CorePoser {
 public:
  void set_pose(const Core& core, const Pose& pose) {
    const std::size_t points = core.points.size(), faces = core.face_count();
    buffer_.resize(points + faces);
    for (std::size_t i = 0; i < points; ++i) buffer_[i] = pose.to_world(core.points[i]);
    for (std::size_t i = 0; i < faces; ++i) buffer_[points + i] = pose.rotate(core.normals[i]);
    posed_core_ = {&core, buffer_.data(), buffer_.data() + points, pose.to_world(core.centre)};
  }
  const PosedCore& get() const { return posed_core_; }

 private:
  std::vector<Vec> buffer_;
  PosedCore posed_core_;
};

// A contact point, halfway between both surfaces, and the gap between them.
struct ContactPoint {
  Vec position;
  double gap;
};

constexpr int MAX_MANIFOLD_POINTS = 4;

// A contact manifold; the normal points from the first to the second body.
struct Manifold {
  Vec normal;
  int count = 0;
  std::array<ContactPoint, MAX_MANIFOLD_POINTS> points{};
};

// The separation along the best axis, negative if the bodies overlap; a lower bound of their
// distance. The search stops early once the gap exceeds a limit.
struct Axis {
  double gap = -std::numeric_limits<double>::infinity();
  Vec normal;  // from the first to the second body
  enum { NONE, FIRST_FACE, SECOND_FACE, EDGES } kind = NONE;
  int first_face = -1, second_face = -1;  // face of the first or second body
  Vec edge_a[2], edge_b[2];               // ends of the edges
};

// The axis along which two cores are separated most.
Axis separating_axis(const PosedCore& a, const PosedCore& b, double max_gap);

// The contact of two cores; without points if their gap is larger than `max_gap`.
Manifold find_manifold(const PosedCore& a, const PosedCore& b, double max_gap);

// Reduces contact points to the four that matter most; the first is the deepest.
void reduce_to_four(std::vector<ContactPoint>& points, Vec normal, Manifold& manifold);

}  // namespace animtool::rigid
