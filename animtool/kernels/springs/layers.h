// Constants of self-contact: the distance that each pair keeps.
#pragma once

#include <cstdint>
#include <vector>

#include "springs/network.h"

namespace animtool {

// Corners keep a distance from triangles, and edges from edges, unless they share a particle: the
// thickness, or the rest distance of pairs closer at rest; less along the surface, so that it can
// bend and compress before it touches.
class SpringLayers {
 public:
  // `rest` are positions at rest (N, 3); `speed` is that of separating pairs that start too close.
  SpringLayers(const SpringNetwork& network, In<double, 2> rest, double thickness, double friction,
               double speed);

  std::size_t particles() const { return particles_; }
  std::size_t triangles() const { return corners_.size() / 3; }
  std::size_t edges() const { return ends_.size() / 2; }
  const std::int32_t* corners(std::size_t triangle) const { return &corners_[3 * triangle]; }
  const std::int32_t* ends(std::size_t edge) const { return &ends_[2 * edge]; }
  // Distance that a particle keeps from a triangle, and an edge from another; 0 without contact.
  double distance(std::size_t triangle, std::int32_t particle) const;
  double edge_distance(std::size_t first, std::size_t second) const;
  double max_edge_distance() const;
  // The same with checked indices.
  double checked_distance(std::int64_t triangle, std::int64_t particle) const;
  double checked_edge_distance(std::int64_t first, std::int64_t second) const;

  const double thickness, friction, speed;

 private:
  void collect_edges();
  void collect_adjacent(const SpringNetwork& network);
  // Whether two particles are close along the surface.
  bool joined(std::int32_t i, std::int32_t j) const;
  double reduced(double at_rest, bool joined) const;

  std::size_t particles_;
  std::vector<std::int32_t> corners_, ends_;
  std::vector<double> rest_;  // rows
  // Particles close to each one along the surface, ascending.
  std::vector<std::size_t> adjacent_starts_;
  std::vector<std::int32_t> adjacent_;
};

}  // namespace animtool
