// A network of springs between particles, with external forces.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "base/arrays.h"
#include "springs/pulls.h"
#include "springs/rows.h"

namespace animtool {

// Springs in solver order, as columns.
struct SpringLines {
  std::vector<Spring> springs;
  std::vector<std::int32_t> numbers;  // theirs in the network
  std::vector<std::int32_t> ends;
  std::vector<double> rest;
  std::vector<SpringRunLength> runs;  // those that share no end in fours
  SpringForces pulls;
  bool tear = false;  // whether any can

  void prepare(std::size_t particles);
};

// Points over knots of time, linear between them and constant outside.
struct Track {
  std::vector<double> rows;  // (K or 1, P, 3)
  std::size_t points = 0;
  bool constant = true;
};

// Where a time lies between knots.
struct KnotPosition {
  std::size_t row;
  double fraction;
};

KnotPosition knot_position(const std::vector<double>& knots, double t);

// From one particle to the next, and from one of its numbers to the next.
struct Strides {
  std::size_t particle, number;
};

// Arrays of a network.
struct SpringArrays {
  In<double, 1> inverse_masses, drags;
  In<std::int64_t, 2> ends;
  In<double, 1> rest, stiffness, damping, limit;
  In<std::int64_t, 2> triangles;
  In<double, 1> gravity;
  double air_drag, air_lift;
  In<double, 1> knots;
  In<std::int64_t, 1> pinned;
  In<double, 3> pinned_path;
  In<std::int64_t, 1> anchors;
  In<double, 1> anchor_stiffness, anchor_damping;
  In<double, 3> anchor_path, winds;
};

// What of particles collides beside themselves.
struct SpringElements {
  std::vector<double> inverse_masses;
  std::vector<std::int32_t> triangles;
  // Of triangles, or of ropes and strands without any: ends two by two, ascending.
  std::vector<std::int32_t> edges;
  double longest_edge = 0;  // at rest, of those that are springs [m]

  std::size_t particles() const { return inverse_masses.size(); }
};

class SpringNetwork : public SpringElements {
 public:
  explicit SpringNetwork(const SpringArrays& arrays);

  // Other paths over the same knots.
  void set_paths(In<double, 3> pinned_path, In<double, 3> anchor_path);

  KnotPosition spot(double t) const { return knot_position(knots, t); }
  // Points of a track at a spot, into (P, 3).
  static void sample_track(const Track& track, const KnotPosition& spot, double* out);

  // Forces [N] of anchors and air, added to rows of particles. Where anchors are and how
  // they move is given, and so is the wind.
  void add_anchor_forces(const double* points, const double* speeds, const double* x,
                         const double* v, double* forces) const;
  void add_air_forces(const double* wind, const double* x, const double* v,
                      double* forces) const;

  // Put held particles where their track is at a time, their velocity that of the way from
  // where they were before: that may be the same place in memory.
  void set_pinned(double t, double h, const double* before, double* x, double* v) const {
    set_pinned(t, h, before, x, v, {ROW, 1});
  }
  void set_pinned(double t, double h, const double* before, double* x, double* v,
                  const Strides& strides) const;

  std::vector<double> drags;
  SpringLines lines;
  double gravity[3];
  double air_drag, air_lift;
  std::vector<double> knots;
  std::vector<std::int32_t> pinned;
  Track pinned_track;
  std::vector<std::int32_t> anchors;
  std::vector<double> anchor_stiffness, anchor_damping;
  Track anchor_track;
  Track wind_track;

 private:
  void collect_edges();
};

// State and workspace of a running network.
class SpringRun {
 public:
  SpringRun(const SpringNetwork& network, const double* x, const double* v,
            const std::uint8_t* torn);

  // Tear springs beyond their limit; returns whether any tore.
  bool tear();

  const SpringNetwork& network;
  std::size_t size;  // of rows
  std::vector<double> x, v;           // in rows
  std::vector<std::uint8_t> torn;

  // Springs that are not torn.
  const SpringLines& lines() const { return untorn_ ? *untorn_ : network.lines; }

  // Anchors and wind at a time; speeds are those of the h before it.
  void sample_surroundings(double t, double h);
  std::vector<double> points, points_before, speeds;
  double wind[3] = {0, 0, 0};

  // Whether forces come of other things than bands of springs; rows of these [N].
  bool has_other_forces() const;
  void set_other_forces(const double* x, const double* v, double* forces) const;

  // Accelerations in rows at a state: held particles have none.
  void accelerate(const double* x, const double* v, double* out);

 private:
  void exclude_torn();

  // Where some are torn, the others.
  std::optional<SpringLines> untorn_;
  ForceBuffers buffers_;
};

// Solver order of springs: by particle, with independent springs next to each other.
std::vector<std::int64_t> order_springs(const std::int64_t* ends, std::size_t springs,
                                        std::size_t particles);

inline double dot3(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

}  // namespace animtool
