// Untangling of self-intersecting surfaces without history.
//
// P. Volino, N. Magnenat-Thalmann, Resolving Surface Collisions through Intersection Contour
// Minimization, 2006: where an edge goes through a triangle the two are moved so that the line
// along which both surfaces cut each other becomes shorter.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "springs/layers.h"
#include "springs/shapes.h"

namespace animtool {

// An edge and a triangle that it goes through.
struct Pierced {
  std::int32_t edge, triangle;
};

// Where an edge goes through a triangle: shares of its ends in that, less than 0 nowhere.
double pierces_at(const shapes::Segment& edge, const shapes::Triangle& triangle);

// Those of edges, ends two by two, and corners of triangles, that share no particle.
std::vector<Pierced> pierced_pairs(const std::vector<double>& x,
                                   const std::vector<std::int32_t>& ends,
                                   const std::vector<std::int32_t>& corners);

class Tangles {
 public:
  Tangles(const SpringLayers& layers, const std::vector<double>& inverse_masses);

  // Finds which edges go through which triangles.
  void find(const std::vector<double>& x);
  bool any() const { return !pairs_.empty(); }
  bool has(std::int32_t particle) const {
    return any() && marked_[static_cast<std::size_t>(particle)];
  }
  // Moves those that still do by this way [m]; where they were goes along.
  void part(double shift, std::vector<double>& before, std::vector<double>& x) const;

 private:
  // The direction for an edge, against a triangle, in which their line becomes shorter.
  collide::Vec shorter(const Pierced& pair, const std::vector<double>& x) const;

  const SpringLayers& layers_;
  const std::vector<double>& inverse_masses_;
  std::vector<std::int32_t> ends_, triangles_;
  // Beside each edge, the third corners of its first two triangles, -1 for none.
  std::vector<std::array<std::int32_t, 2>> adjacent_;
  std::vector<Pierced> pairs_;
  std::vector<std::uint8_t> marked_;
};

}  // namespace animtool
