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
struct EdgePiercing {
  std::int32_t edge, triangle;
};

// The fraction along an edge at which it pierces a triangle; -1 if it does not.
double find_piercing(const shapes::Segment& edge, const shapes::Triangle& triangle);

// Finds edges (pairs of particles) that pierce triangles without a shared particle.
std::vector<EdgePiercing> find_piercings(const std::vector<double>& x,
                                         const std::vector<std::int32_t>& ends,
                                         const std::vector<std::int32_t>& corners);

// Finds and resolves the intersections of a surface with itself.
class Tangles {
 public:
  Tangles(const SpringLayers& layers, const std::vector<double>& inverse_masses);

  // Finds all edges that pierce triangles, and marks their particles as tangled.
  void find(const std::vector<double>& x);
  bool has_piercings() const { return !piercings_.empty(); }
  bool is_tangled(std::int32_t particle) const {
    return has_piercings() && is_tangled_[static_cast<std::size_t>(particle)];
  }
  // Moves elements that still pierce each other by a distance [m], together with their previous
  // positions.
  void untangle(double distance, std::vector<double>& before, std::vector<double>& x) const;

 private:
  // The direction in which an edge moves relative to a triangle to shorten the contour.
  collide::Vec shortening_direction(const EdgePiercing& piercing,
                                    const std::vector<double>& x) const;

  const SpringLayers& layers_;
  const std::vector<double>& inverse_masses_;
  std::vector<std::int32_t> ends_, triangles_;
  // The opposite corners of the first two triangles at each edge, -1 for none.
  std::vector<std::array<std::int32_t, 2>> opposite_corners_;
  std::vector<EdgePiercing> piercings_;
  std::vector<std::uint8_t> is_tangled_;
};

}  // namespace animtool
