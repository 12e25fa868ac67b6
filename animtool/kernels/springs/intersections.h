// Untangling of self-intersecting surfaces without history.
//
// P. Volino, N. Magnenat-Thalmann, Resolving Surface Collisions through Intersection Contour
// Minimization, 2006: an edge and a triangle that it intersects are moved so that the intersection
// contour of the surfaces becomes shorter.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "springs/layers.h"
#include "springs/shapes.h"

namespace animtool {

// An edge and a triangle that it intersects.
struct EdgeIntersection {
  std::int32_t edge, triangle;
};

// The fraction along an edge at which it intersects a triangle; -1 if it does not.
double find_intersection(const shapes::Segment& edge, const shapes::Triangle& triangle);

// Finds edges (pairs of particles) that intersect triangles without a shared particle.
std::vector<EdgeIntersection> find_intersections(const std::vector<double>& x,
                                                 const std::vector<std::int32_t>& ends,
                                                 const std::vector<std::int32_t>& corners);

// Finds and resolves the intersections of a surface with itself.
class IntersectionResolver {
 public:
  IntersectionResolver(const SpringLayers& layers, const std::vector<double>& inverse_masses);

  // Finds all edges that intersect triangles, and marks their particles.
  void find(const std::vector<double>& x);
  bool has_intersections() const { return !intersections_.empty(); }
  bool is_intersecting(std::int32_t particle) const {
    return has_intersections() && is_intersecting_[static_cast<std::size_t>(particle)];
  }
  // Moves elements that still intersect by a distance [m], together with their previous
  // positions.
  void resolve(double distance, std::vector<double>& before, std::vector<double>& x) const;

 private:
  // The direction in which an edge moves relative to a triangle to shorten the contour.
  collide::Vec shortening_direction(const EdgeIntersection& intersection,
                                    const std::vector<double>& x) const;

  const SpringLayers& layers_;
  const std::vector<double>& inverse_masses_;
  std::vector<std::int32_t> ends_, triangles_;
  // The opposite corners of the first two triangles at each edge, -1 for none.
  std::vector<std::array<std::int32_t, 2>> opposite_corners_;
  std::vector<EdgeIntersection> intersections_;
  std::vector<std::uint8_t> is_intersecting_;
};

}  // namespace animtool
