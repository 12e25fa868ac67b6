// A network of springs between particles, with external forces.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "base/arrays.h"
#include "springs/forces.h"
#include "springs/rows.h"

namespace animtool {

// Springs in solver order, with their numbers as columns.
struct SpringSet {
  std::vector<Spring> springs;
  std::vector<std::int32_t> indices;  // of the springs in the network
  std::vector<std::int32_t> ends;
  std::vector<double> rest_lengths;
  std::vector<SpringRunLength> runs;  // groups of four springs without a shared end
  SpringForces forces;
  bool can_tear = false;  // whether any spring can tear

  // Fills the columns and runs from `springs`.
  void prepare(std::size_t particles);
};

// Paths of points over knots of time: linear between knots, constant outside of them.
struct Track {
  std::vector<double> positions;  // (K or 1, P, 3)
  std::size_t points = 0;
  bool is_constant = true;
};

// The knot interval that a time is in, and the fraction of it.
struct KnotInterval {
  std::size_t knot_index;
  double fraction;
};

KnotInterval find_knot_interval(const std::vector<double>& knot_times, double t);

// Array strides from one particle to the next, and from one component to the next.
struct Strides {
  std::size_t particle, component;
};

// Arrays that define a network.
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

// Edges and triangles of particles, for collisions.
struct SpringElements {
  std::vector<double> inverse_masses;
  std::vector<std::int32_t> triangles;
  // Pairs of particles, ascending: of triangles, or without triangles of ropes and strands.
  std::vector<std::int32_t> edges;
  double longest_edge = 0;  // largest rest length of a spring along an edge [m]

  std::size_t particle_count() const { return inverse_masses.size(); }
};

// Particles, springs between them, and external forces.
class SpringNetwork : public SpringElements {
 public:
  explicit SpringNetwork(const SpringArrays& arrays);

  // Replaces the paths of pinned particles and anchors over the same knots.
  void set_paths(In<double, 3> pinned_path, In<double, 3> anchor_path);

  KnotInterval interval_at(double t) const { return find_knot_interval(knot_times, t); }
  // Computes the points of a track at a time (P, 3).
  static void sample_track(const Track& track, const KnotInterval& interval, double* out);

  // Add the forces [N] of anchors, given their positions and velocities, and of air, given the
  // wind, to rows of particles.
  void add_anchor_forces(const double* anchor_points, const double* anchor_velocities,
                         const double* x, const double* v, double* forces) const;
  void add_air_forces(const double* wind, const double* x, const double* v, double* forces) const;

  // Moves pinned particles to their track at a time. Their velocity is the displacement from
  // `before` over h; `before` may be the same array as x.
  void set_pinned(double t, double h, const double* before, double* x, double* v) const {
    set_pinned(t, h, before, x, v, {PARTICLE_STRIDE, 1});
  }
  void set_pinned(double t, double h, const double* before, double* x, double* v,
                  const Strides& strides) const;

  std::vector<double> drags;
  SpringSet spring_set;
  double gravity[3];
  double air_drag, air_lift;
  std::vector<double> knot_times;
  std::vector<std::int32_t> pinned_particles;
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
            const std::uint8_t* is_torn);

  // Tears springs beyond their limit; returns whether any tore.
  bool tear();

  const SpringNetwork& network;
  std::size_t size;          // of x and v
  std::vector<double> x, v;  // in rows
  std::vector<std::uint8_t> is_torn;

  // The springs that are not torn.
  const SpringSet& spring_set() const {
    return intact_spring_set_ ? *intact_spring_set_ : network.spring_set;
  }

  // Samples anchors and wind at a time; velocities are those over the preceding h.
  void sample_surroundings(double t, double h);
  std::vector<double> anchor_points, anchor_points_before, anchor_velocities;
  double wind[3] = {0, 0, 0};

  // Whether there are forces other than those of bands; and computes these forces [N].
  bool has_other_forces() const;
  void compute_other_forces(const double* x, const double* v, double* forces) const;

  // Computes accelerations at a state, in rows; 0 for pinned particles.
  void accelerate(const double* x, const double* v, double* out);

 private:
  void remove_torn();

  // The springs that are not torn; unset if none is torn.
  std::optional<SpringSet> intact_spring_set_;
  ForceBuffers buffers_;
};

// Solver order of springs: by particle, with independent springs next to each other.
std::vector<std::int64_t> order_springs(const std::int64_t* ends, std::size_t spring_count,
                                        std::size_t particle_count);

inline double dot3(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

}  // namespace animtool
