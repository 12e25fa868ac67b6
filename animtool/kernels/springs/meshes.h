// Collisions of particles with meshes, with caches over the steps.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <tuple>
#include <vector>

#include "colliders/colliders.h"
#include "colliders/surface.h"

namespace animtool {

// The motion of a mesh so far: its mean displacement, and the largest displacement relative to it.
struct MeshMotion {
  collide::Vec drift;
  double spread = 0;
  // The current knot interval, in which motion is linear, -1 for none; and its elapsed fraction.
  std::int64_t knot = -1;
  double fraction = 0;
};

// A mesh in a knot interval: boxes of its nodes at the start, boxes of the displacements of their
// points, and how far back in time particles are tested [fraction of the interval].
struct KnotBoxes {
  const double *start_bounds, *shift_bounds;
  double lookback;
};

// Caches the triangles near each particle. A cache is filled by the tree, and is valid as long as
// particle and mesh move less than a slack. The slack does not change the result.
class MeshPatches {
 public:
  struct PatchHit {
    collide::Sample sample;
    std::int32_t triangle = -1;  // -1 if the distance is only a bound
  };

  // `slack` is the initial displacement for which a cache is valid.
  MeshPatches(std::size_t particles, double slack) : patches_(particles) {
    for (Patch& patch : patches_) patch.next_slack = slack;
  }

  // The distance of the mesh from a point in its frame. With `allows_bound`, returns a lower bound
  // if that exceeds the contact distance.
  PatchHit query(const collide::Mesh& mesh, std::int32_t root, std::size_t n, collide::Vec p,
                 const MeshMotion& motion, const KnotBoxes* boxes, double contact_distance,
                 bool allows_bound);
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
  // The cache of one particle.
  struct Patch {
    collide::Vec position;
    MeshMotion motion;
    // Displacement for which the cache is valid, negative if invalid; the slack of the next cache.
    double slack = -1, next_slack = 0;
    double distance = 0;
    // Slack and smallest distance over the remaining knot interval, relative to the nearest
    // triangle.
    double knot_slack = -1, min_distance = 0, lookback = 0;
    collide::Vec triangle_shift;
    std::int32_t count = 0, candidates_index = -1;
    std::int32_t seed_triangle = -1;  // a nearby triangle, where the next search starts
  };
  // A triangle near a particle: its distance now, and the smallest in the remaining knot interval.
  struct NearbyTriangle {
    double distance, min_distance;
    std::int32_t triangle;
  };

  // Displacement since the cache was filled, negative if the cache is invalid; sets `is_in_knot` if
  // it is relative to the nearest triangle.
  static double displacement_since(const Patch& patch, collide::Vec p, const MeshMotion& motion,
                                   bool& is_in_knot);
  // The nearest cached triangle.
  collide::Nearest nearest(const Patch& patch, const collide::Mesh& mesh, collide::Vec p,
                           double displacement) const;
  // Fills the cache of a particle; returns its distance from the mesh.
  PatchHit fill_cache(Patch& patch, const collide::Mesh& mesh, std::int32_t root, collide::Vec p,
                      const KnotBoxes* boxes, double contact_distance, bool allows_bound);
  // Finds the nearest triangle, starting from a recent one, and all nearby ones.
  collide::Nearest search(Patch& patch, const collide::Mesh& mesh, std::int32_t root,
                          collide::Vec p, const KnotBoxes* boxes, double contact_distance);
  // Stores nearby triangles, if there are few, by their distance now or in the remaining knot
  // interval.
  bool store_candidates(Patch& patch, double max_distance, bool is_in_knot);

  std::vector<Patch> patches_;
  // Cached triangles of particles that have any.
  std::vector<Candidates> candidates_;
  // Results of the last search: nearby triangles, and the smallest distance in the knot interval.
  std::vector<NearbyTriangle> nearby_triangles_;
  double min_distance_ = 0;
  std::int32_t last_triangle_ = -1;  // the nearest triangle of the last search
};

// A mesh whose points move: positions at knots of time (K, P, 3), linear between them; restitution,
// friction, margin, depenetration speed and teleport speed; time intervals per knot interval; and
// elapsed time intervals of the first knot interval.
using SpringSurface = std::tuple<const MeshSurface*, In<double, 3>, std::array<double, 5>,
                                 std::int64_t, std::int64_t>;

// A moving mesh over intervals of time.
class MovingSurface {
 public:
  MovingSurface(const SpringSurface& surface, std::int64_t interval_count);

  // Advances to an interval. Returns whether the motion is continuous.
  bool begin_interval(std::int64_t interval, double duration);
  // The elapsed fraction of the knot interval at a fraction of the interval.
  double knot_fraction(double fraction) const {
    return knot_start_fraction_ + fraction / static_cast<double>(intervals_per_knot_);
  }
  // The collider at a fraction of the knot interval, and the motion of the mesh up to it.
  collide::Collider collider(double fraction) const;
  MeshMotion motion_until(double fraction) const;
  // Boxes of the knot interval, for tests that go back by a fraction of it.
  KnotBoxes boxes(double lookback) const {
    return {start_bounds_.data(), shift_bounds_.data(), lookback};
  }
  // The largest displacement of a point in the knot interval.
  double max_displacement() const { return max_displacement_; }
  // The largest displacement of a point relative to a drift, over a fraction of the knot interval.
  double max_relative_displacement(collide::Vec drift, double fraction) const;
  // The box of all triangles.
  const double* box() const { return bounds_.data(); }
  double margin() const { return settings_[2]; }
  // Marks points whose radius of curvature is below a limit at the last knot or when the mesh was
  // built, and finds the largest nodes below a size that contain any.
  void find_fine_points(double max_radius, double max_size);
  bool is_fine(std::int32_t point) const { return is_fine_[static_cast<std::size_t>(point)]; }
  const std::vector<std::int32_t>& fine_nodes() const { return fine_nodes_; }
  // A box of a node at a fraction of the knot interval.
  std::array<collide::Vec, 2> box_at(std::int32_t node, double fraction) const {
    const auto row = 6 * static_cast<std::size_t>(node);
    if (!(max_displacement_ > 0))
      return {collide::load(&bounds_[row]), collide::load(&bounds_[row + 3])};
    const auto corner = [&](std::size_t k) {
      return collide::load(&start_bounds_[k]) + collide::load(&shift_bounds_[k]) * fraction;
    };
    return {corner(row), corner(row + 3)};
  }
  // Any point of the triangles below a node.
  std::int32_t point_below(std::int32_t node) const;
  // Displacement of the point of a triangle nearest to p, in the knot interval.
  collide::Vec surface_shift(const collide::Mesh& mesh, std::int32_t triangle,
                             collide::Vec p) const;

 private:
  void measure_motion(const double* begin, const double* end);

  std::vector<std::uint8_t> is_fine_;
  std::vector<std::int32_t> fine_nodes_;
  const MeshSurface* surface_;
  In<double, 3> points_;
  std::array<double, 5> settings_;
  std::vector<double> shifts_, bounds_, start_bounds_, shift_bounds_;
  std::int64_t intervals_per_knot_, first_interval_;
  const double* knot_points_ = nullptr;
  MeshMotion past_motion_, knot_motion_;  // before the knot interval, and in it
  double max_displacement_ = 0, knot_start_fraction_ = 0;
  std::int64_t knot_ = -1;
};

}  // namespace animtool
