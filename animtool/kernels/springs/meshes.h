// Meshes as particles of springs meet them, step after step.
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
struct MeshWay {
  collide::Vec drift;
  double spread = 0;
};

// What of a mesh is near each particle. It is found by the tree, and serves for as long as
// particle and mesh go no farther than some slack; whatever it is, the answer is the same.
class MeshPatches {
 public:
  struct Found {
    collide::Sample sample;
    std::int32_t triangle = -1;  // none where the distance is only a bound
  };

  // Slack to begin with.
  MeshPatches(std::size_t particles, double slack) : patches_(particles) {
    for (Patch& patch : patches_) patch.fine = slack;
  }

  // The mesh from a point of its frame: its distance, or, where that is more than is kept
  // and asked for, one that is less but still more than is kept.
  Found look(const collide::Mesh& mesh, std::int32_t root, std::size_t n, collide::Vec p,
             const MeshWay& gone, double kept, bool bound);
  // Nothing is known any more.
  void forget();

 private:
  static constexpr int MOST = 24;
  struct Candidate {
    double distance;
    std::int32_t triangle;
  };
  // Nearest first.
  using Candidates = std::array<Candidate, MOST>;
  struct Patch {
    collide::Vec at;
    MeshWay gone;
    // How far it serves, less than 0 not at all; how far the next is to serve.
    double slack = -1, fine = 0;
    double distance = 0;
    std::int32_t count = 0, place = -1;
  };

  collide::Nearest nearest(const Patch& patch, const collide::Mesh& mesh, collide::Vec p,
                           double went) const;
  Found gather(Patch& patch, const collide::Mesh& mesh, std::int32_t root, collide::Vec p,
               double kept, bool bound);
  void collect(Patch& patch, const collide::Mesh& mesh, std::int32_t root, collide::Vec p);

  std::vector<Patch> patches_;
  // Of those that were near.
  std::vector<Candidates> candidates_;
};

// A mesh whose points move: these at knots of time (K, P, 3), straight from one to the next;
// its restitution, friction, margin, depenetration and the speed from which on it was put
// elsewhere; how many cells of time each knot lasts, and how many of the first are over.
using SpringSurface = std::tuple<const MeshSurface*, In<double, 3>, std::array<double, 5>,
                                 std::int64_t, std::int64_t>;

// Such a mesh over cells of time.
class MovingSurface {
 public:
  MovingSurface(const SpringSurface& surface, std::int64_t cells);

  // Goes on to a cell of some length. Returns whether it goes on from where it was.
  bool enter(std::int64_t cell, double length);
  // What share of its knot is gone when a share of the cell is.
  double gone(double share) const { return begun_ + share / static_cast<double>(lasts_); }
  // As what is met when a share of the knot is gone, and how it has gone until then.
  collide::Collider collider(double share) const;
  MeshWay way_until(double share) const;
  // The most that a point goes in the whole knot, and how its nearest point goes.
  double travel() const { return travel_; }
  const double* box() const { return bounds_.data(); }
  double margin() const { return numbers_[2]; }
  collide::Vec way(const collide::Mesh& mesh, std::int32_t triangle, collide::Vec p) const;

 private:
  void measure(const double* begin, const double* end);

  const MeshSurface* surface_;
  In<double, 3> points_;
  std::array<double, 5> numbers_;
  std::vector<double> ways_, bounds_;
  std::int64_t lasts_, first_;
  const double* begin_ = nullptr;
  MeshWay before_, whole_;  // until the knot, and in it
  double travel_ = 0, begun_ = 0;
  std::int64_t last_ = -1;
};

}  // namespace animtool
