// Constants of self-contact: the distance that each pair of elements keeps.
#pragma once

#include <cstdint>
#include <vector>

#include "springs/network.h"

namespace animtool {

// Corners keep a distance from triangles, and edges from edges, unless they share a particle. The
// distance is the thickness, or the rest distance of pairs that are closer at rest. It is smaller
// along the surface, so that the surface can bend and compress before it touches itself.
class SpringLayers {
 public:
  // `rest_positions` are rest positions (N, 3); `separation_speed` is the largest speed at which
  // pairs that start too close are separated.
  SpringLayers(const SpringNetwork& network, In<double, 2> rest_positions, double thickness,
               double friction, double separation_speed);

  std::size_t particle_count() const { return particles_; }
  std::size_t triangle_count() const { return corners_.size() / 3; }
  std::size_t edge_count() const { return ends_.size() / 2; }
  const std::int32_t* corners(std::size_t triangle) const { return &corners_[3 * triangle]; }
  const std::int32_t* ends(std::size_t edge) const { return &ends_[2 * edge]; }
  // Distance that a particle keeps from a triangle, and an edge from an edge; 0 for pairs without
  // contact.
  double distance(std::size_t triangle, std::int32_t particle) const;
  double edge_distance(std::size_t first, std::size_t second) const;
  double max_edge_distance() const;
  // Checks the indices first.
  double checked_distance(std::int64_t triangle, std::int64_t particle) const;
  double checked_edge_distance(std::int64_t first, std::int64_t second) const;

  const double thickness, friction, separation_speed;

 private:
  void collect_edges();
  void collect_adjacent_particles(const SpringNetwork& network);
  // Whether two particles are close along the surface.
  bool is_adjacent(std::int32_t i, std::int32_t j) const;
  // Contact distance of a pair with a rest distance.
  double contact_distance(double rest_gap, bool is_adjacent) const;

  std::size_t particles_;
  std::vector<std::int32_t> corners_, ends_;
  std::vector<double> rest_positions_;  // rows of rest positions
  // Particles that are close to each particle along the surface, ascending.
  std::vector<std::size_t> adjacent_particle_starts_;
  std::vector<std::int32_t> adjacent_particles_;
};

}  // namespace animtool
