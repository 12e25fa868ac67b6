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

// How a mesh has gone: all points by a drift, each by no more than a spread beside it.
struct MeshShift {
  collide::Vec drift;
  double spread = 0;
  // In a knot in which all goes straight, its number and the share that is gone; -1 in none.
  std::int64_t knot = -1;
  double fraction = 0;
};

// A mesh in such a knot: boxes of its nodes as it begins, and of the ways of their points,
// and how far before a moment particles are looked at [share of the knot].
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

  // Slack to begin with.
  MeshPatches(std::size_t particles, double slack) : patches_(particles) {
    for (Patch& patch : patches_) patch.next_slack = slack;
  }

  // The mesh from a point of its frame: its distance, or, where that is more than is kept
  // and asked for, one that is less but still more than is kept.
  PatchHit query(const collide::Mesh& mesh, std::int32_t root, std::size_t n, collide::Vec p,
             const MeshShift& motion, const KnotBoxes* boxes, double contact_distance, bool bound);
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
    // How far it serves, less than 0 not at all; how far the next is to serve.
    double slack = -1, next_slack = 0;
    double distance = 0;
    // The same for what is left of the knot, beside the way of what was nearest.
    double knot_slack = -1, min_distance = 0, back = 0;
    collide::Vec shift;
    std::int32_t count = 0, location = -1;
    std::int32_t last = -1;  // a triangle that was near
  };
  // Near a particle: how far, and how far at least in what is left of the knot.
  struct NearbyTriangle {
    double distance, min_distance;
    std::int32_t triangle;
  };

  // How far a particle went since it was looked at, where what was found then serves; else
  // less than 0. With whether that is beside the way of what was nearest.
  static double displacement_since(const Patch& patch, collide::Vec p, const MeshShift& motion, bool& in_knot);
  collide::Nearest nearest(const Patch& patch, const collide::Mesh& mesh, collide::Vec p,
                           double displacement) const;
  PatchHit gather(Patch& patch, const collide::Mesh& mesh, std::int32_t root, collide::Vec p,
               const KnotBoxes* boxes, double contact_distance, bool bound);
  // The nearest, by what was near before, and what else is near, unless it is farther than
  // what is kept by more than that.
  collide::Nearest search(Patch& patch, const collide::Mesh& mesh, std::int32_t root,
                               collide::Vec p, const KnotBoxes* boxes, double contact_distance);
  // Keeps what is near, if it is not too much; by what is left of the knot or as it is.
  bool store_candidates(Patch& patch, double reach, bool in_knot);

  std::vector<Patch> patches_;
  // Of those that were near.
  std::vector<Candidates> candidates_;
  // Of the last look: what is near, and the least that anything comes to in the knot.
  std::vector<NearbyTriangle> nearby_;
  double min_distance_ = 0;
  std::int32_t last_ = -1;  // the triangle that was nearest then
};

// A mesh whose points move: these at knots of time (K, P, 3), straight from one to the next;
// its restitution, friction, margin, depenetration and the speed from which on it was put
// elsewhere; how many cells of time each knot lasts, and how many of the first are over.
using SpringSurface = std::tuple<const MeshSurface*, In<double, 3>, std::array<double, 5>,
                                 std::int64_t, std::int64_t>;

// A moving mesh over cells of time.
class MovingSurface {
 public:
  MovingSurface(const SpringSurface& surface, std::int64_t cells);

  // Goes on to a cell of some length. Returns whether it goes on from where it was.
  bool begin_cell(std::int64_t cell, double length);
  // What share of its knot is gone when a share of the cell is.
  double knot_fraction(double fraction) const { return knot_start_ + fraction / static_cast<double>(cells_per_knot_); }
  // As what is met when a share of the knot is gone, and how it has gone until then.
  collide::Collider collider(double fraction) const;
  MeshShift shift_until(double fraction) const;
  // Boxes of the knot, none where it stands; a part of a cell is looked back.
  KnotBoxes boxes(double back) const { return {begins_.data(), shift_bounds_.data(), back}; }
  // The most that a point goes in the whole knot, and how its nearest point goes.
  double travel() const { return travel_; }
  // The largest displacement of a point beside a drift, over a fraction of the knot.
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
  MeshShift before_, full_;  // until the knot, and in it
  double travel_ = 0, knot_start_ = 0;
  std::int64_t last_ = -1;
};

}  // namespace animtool
