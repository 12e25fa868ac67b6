// Mesh collisions of particles, with caches over the steps.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <tuple>
#include <vector>

#include "colliders/colliders.h"
#include "colliders/surface.h"

namespace animtool {

// The motion of a mesh so far: a common drift, and the largest displacement relative to it.
struct MeshShift {
  collide::Vec drift;
  double spread = 0;
  // The current interval of linear motion, -1 for none, and the elapsed fraction of it.
  std::int64_t knot = -1;
  double fraction = 0;
};

// A mesh in such an interval: boxes of its nodes at the start, and of the displacements of their
// points, and how far back in time particles are tested [fraction of the interval].
struct KnotBoxes {
  const double *begins, *shifts;
  double back;
};

// Cache of mesh parts near each particle. Filled by the tree, and valid as long as particle and
// mesh move less than a slack; the slack does not change the result.
class MeshPatches {
 public:
  struct PatchHit {
    collide::Sample sample;
    std::int32_t triangle = -1;  // none where the distance is only a bound
  };

  // `slack` is the initial one.
  MeshPatches(std::size_t particles, double slack) : patches_(particles) {
    for (Patch& patch : patches_) patch.next_slack = slack;
  }

  // The distance of the mesh from a point of its frame; with `bound`, a lower bound suffices if it
  // exceeds the contact distance.
  PatchHit query(const collide::Mesh& mesh, std::int32_t root, std::size_t n, collide::Vec p,
                 const MeshShift& motion, const KnotBoxes* boxes, double contact_distance,
                 bool bound);
  // Invalidates the cache.
  void invalidate();

 private:
  static constexpr int MAX_CANDIDATES = 32;
  struct Candidate {
    double distance;
    std::int32_t triangle;
  };
  // Nearest first.
  using Candidates = std::array<Candidate, MAX_CANDIDATES>;
  struct Patch {
    collide::Vec at;
    MeshShift motion;
    // Displacement for which it is valid, negative if it is not; the slack of the next one.
    double slack = -1, next_slack = 0;
    double distance = 0;
    // The same for the rest of the interval, relative to the nearest triangle.
    double knot_slack = -1, min_distance = 0, back = 0;
    collide::Vec shift;
    std::int32_t count = 0, location = -1;
    std::int32_t last = -1;  // a nearby triangle
  };
  // A triangle near a particle: its distance, and the smallest in the rest of the interval.
  struct NearbyTriangle {
    double distance, min_distance;
    std::int32_t triangle;
  };

  // Displacement since the cache was filled, negative if it is invalid; `in_knot` tells whether it
  // is relative to the nearest triangle.
  static double displacement_since(const Patch& patch, collide::Vec p, const MeshShift& motion,
                                   bool& in_knot);
  collide::Nearest nearest(const Patch& patch, const collide::Mesh& mesh, collide::Vec p,
                           double displacement) const;
  PatchHit gather(Patch& patch, const collide::Mesh& mesh, std::int32_t root, collide::Vec p,
                  const KnotBoxes* boxes, double contact_distance, bool bound);
  // The nearest triangle, starting from the last one, and all nearby ones.
  collide::Nearest search(Patch& patch, const collide::Mesh& mesh, std::int32_t root,
                          collide::Vec p, const KnotBoxes* boxes, double contact_distance);
  // Stores nearby triangles, if they are few: by their distance in the rest of the interval, or
  // now.
  bool store_candidates(Patch& patch, double reach, bool in_knot);

  std::vector<Patch> patches_;
  // Of patches with nearby triangles.
  std::vector<Candidates> candidates_;
  // Of the last search: nearby triangles, and the smallest distance in the interval.
  std::vector<NearbyTriangle> nearby_;
  double min_distance_ = 0;
  std::int32_t last_ = -1;  // the nearest triangle of the last search
};

// A mesh whose points move: positions at knots of time (K, P, 3), linear between them; restitution,
// friction, margin, depenetration speed and teleport speed; cells of time per knot interval, and
// elapsed cells of the first one.
using SpringSurface = std::tuple<const MeshSurface*, In<double, 3>, std::array<double, 5>,
                                 std::int64_t, std::int64_t>;

// A moving mesh over cells of time.
class MovingSurface {
 public:
  MovingSurface(const SpringSurface& surface, std::int64_t cells);

  // Moves on to a cell. Returns whether the motion is continuous.
  bool begin_cell(std::int64_t cell, double length);
  // The elapsed fraction of the knot interval at a fraction of the cell.
  double knot_fraction(double fraction) const {
    return knot_start_ + fraction / static_cast<double>(cells_per_knot_);
  }
  // The collider at a fraction of the knot interval, and its motion until then.
  collide::Collider collider(double fraction) const;
  MeshShift shift_until(double fraction) const;
  // Boxes of the knot interval; tested `back` in time.
  KnotBoxes boxes(double back) const { return {begins_.data(), shift_bounds_.data(), back}; }
  // The largest displacement of a point in the knot interval.
  double travel() const { return travel_; }
  // The largest displacement of a point relative to a drift, over a fraction of the interval.
  double relative_travel(collide::Vec drift, double fraction) const;
  const double* box() const { return bounds_.data(); }
  double margin() const { return numbers_[2]; }
  collide::Vec shift(const collide::Mesh& mesh, std::int32_t triangle, collide::Vec p) const;

 private:
  void measure(const double* begin, const double* end);

  const MeshSurface* surface_;
  In<double, 3> points_;
  std::array<double, 5> numbers_;
  std::vector<double> shifts_, bounds_, begins_, shift_bounds_;
  std::int64_t cells_per_knot_, first_;
  const double* begin_ = nullptr;
  MeshShift before_, full_;  // until the knot interval, and in it
  double travel_ = 0, knot_start_ = 0;
  std::int64_t last_ = -1;
};

}  // namespace animtool
