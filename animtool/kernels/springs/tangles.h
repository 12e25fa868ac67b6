// Untangling of self-intersecting surfaces without history.
//
// P. Volino, N. Magnenat-Thalmann, Resolving Surface Collisions through Intersection Contour
// Minimization, 2006: an edge and a triangle that it pierces are moved so that the intersection
// contour of the surfaces becomes shorter.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "springs/layers.h"
#include "springs/shapes.h"

namespace animtool {

// An edge and a triangle that it pierces.
struct Pierced {
  std::int32_t edge, triangle;
};

// The fraction along an edge at which it pierces a triangle; negative if it does not.
double pierces_at(const shapes::Segment& edge, const shapes::Triangle& triangle);

// Piercings of edges (pairs of particles) and triangles without a shared particle.
std::vector<Pierced> pierced_pairs(const std::vector<double>& x,
                                   const std::vector<std::int32_t>& ends,
                                   const std::vector<std::int32_t>& corners);

class Tangles {
 public:
  Tangles(const SpringLayers& layers, const std::vector<double>& inverse_masses);

  // Finds all edges that pierce triangles.
  void find(const std::vector<double>& x);
  bool any() const { return !pairs_.empty(); }
  bool has(std::int32_t particle) const {
    return any() && marked_[static_cast<std::size_t>(particle)];
  }
  // Moves those that still do by a distance [m], together with their previous positions.
  void part(double shift, std::vector<double>& before, std::vector<double>& x) const;

 private:
  // The direction of an edge, relative to a triangle, that shortens the contour.
  collide::Vec shorter(const Pierced& pair, const std::vector<double>& x) const;

  const SpringLayers& layers_;
  const std::vector<double>& inverse_masses_;
  std::vector<std::int32_t> ends_, triangles_;
  // The opposite corners of the first two triangles of each edge, -1 for none.
  std::vector<std::array<std::int32_t, 2>> adjacent_;
  std::vector<Pierced> pairs_;
  std::vector<std::uint8_t> marked_;
};

}  // namespace animtool
