// Self-contact of pairs of one kind over the steps of a run.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "springs/intersections.h"
#include "springs/separation.h"

namespace animtool {

// Two elements that intersect, and the side (1 or -1) from which the first came.
struct Intersection {
  std::int32_t first, second, side;

  bool operator<(const Intersection& other) const {
    return std::pair(first, second) < std::pair(other.first, other.second);
  }
};

// Contacts between pairs of elements. Kind: TrianglesAndCorners or EdgesAndEdges. Pair lists only
// save time: the contacts of a step do not depend on when the lists were built.
template <class Kind>
class LayerContacts {
 public:
  using Shape = typename Kind::Shape;

  std::vector<Intersection> intersections;
  void sort_intersections() { std::sort(intersections.begin(), intersections.end()); }

  // `list_pairs` lists all pairs within a distance. `filter_near_pairs` picks those that may be
  // near now, given the displacements of particles since they were listed.
  void list_pairs(const SpringLayers& layers, const std::vector<double>& x, double distance) {
    listed_pairs_ = Kind::find_near(layers, x, distance);
  }
  void filter_near_pairs(const SpringLayers& layers, const std::vector<double>& x,
                         const std::vector<double>& displacements, double distance);

  // Finds the contacts of a step: `max_travel` is the largest tested relative displacement,
  // `return_margin` the extra distance of pairs that only return to the contact distance.
  // Intersecting pairs have no known side, and are skipped.
  void find_contacts(const SpringLayers& layers, const std::vector<double>& before,
                     const std::vector<double>& x, double max_travel, double return_margin,
                     const IntersectionResolver* resolver);
  void clear_contacts() { hits_.clear(); }
  bool has_hits() const { return !hits_.empty(); }
  void separate(const SpringLayers& layers, Separation& separation) const;
  // Collects picked pairs with a moved particle that passed through each other since the start of
  // the step.
  void collect_tunnelling(const SpringLayers& layers, const std::vector<double>& from,
                          const std::vector<double>& x, const std::vector<std::uint8_t>& is_moved,
                          const IntersectionResolver& resolver,
                          std::vector<LayerHit>& tunnelling) const;
  // Drops intersections that are resolved, or whose elements moved apart.
  void drop_resolved(const SpringLayers& layers, const std::vector<double>& x);
  // Records the pairs that intersect at the end of the step.
  void record_intersections(const std::vector<double>& before, const std::vector<double>& x);

 private:
  // The largest relative displacement of two elements in the step.
  static double relative_shift(const FourParticles& particles, const std::vector<double>& before,
                               const std::vector<double>& x);
  // The side from which the first element came; 0 if it did not cross the second.
  std::int32_t side_of(const LayerHit& hit, const std::vector<double>& before,
                       const std::vector<double>& x) const;
  // Whether the elements are on the wrong side of each other.
  static bool is_intersecting(std::int32_t side, const Shape& current) {
    return side * current.height() < 0 && current.nearest().is_interior;
  }
  // Whether one element intersects a neighbour of the other, so that its side of the other is
  // undefined.
  bool is_next_to_intersection(const SpringLayers& layers, const LayerHit& hit) const;

  std::vector<LayerPair> listed_pairs_, near_pairs_;
  std::vector<LayerHit> hits_;
  Intersections step_intersections_;
};

template <class Kind>
void LayerContacts<Kind>::filter_near_pairs(const SpringLayers& layers,
                                            const std::vector<double>& x,
                                            const std::vector<double>& displacements,
                                            double distance) {
  const auto max_displacement = [&](const std::int32_t* first, const std::int32_t* last) {
    double largest = 0;
    for (; first != last; ++first)
      largest = std::max(largest, displacements[static_cast<std::size_t>(*first)]);
    return largest;
  };
  near_pairs_.clear();
  for (const LayerPair& pair : listed_pairs_) {
    const FourParticles particles = Kind::particles(layers, pair.first, pair.second);
    const double max_approach =
        max_displacement(&particles[0], &particles[Kind::FIRST_PARTICLE_COUNT]) +
        max_displacement(&particles[Kind::FIRST_PARTICLE_COUNT], particles.data() + 4);
    if (pair.gap - max_approach - pair.distance > distance) continue;
    if (length(Shape(particles.data(), x.data()).nearest().offset) - pair.distance <= distance)
      near_pairs_.push_back(pair);
  }
}

template <class Kind>
void LayerContacts<Kind>::find_contacts(const SpringLayers& layers,
                                        const std::vector<double>& before,
                                        const std::vector<double>& x, double max_travel,
                                        double return_margin,
                                        const IntersectionResolver* resolver) {
  const auto are_intersecting = [&](const std::int32_t* first, const std::int32_t* last) {
    return std::all_of(first, last, [&](std::int32_t n) { return resolver->is_intersecting(n); });
  };
  hits_.clear();
  step_intersections_.clear();
  for (const LayerPair& pair : near_pairs_) {
    const FourParticles particles = Kind::particles(layers, pair.first, pair.second);
    const shapes::Nearest nearest = Shape(particles.data(), x.data()).nearest();
    const double gap = length(nearest.offset);
    if (!(gap < pair.distance + max_travel + return_margin)) continue;
    const double travel = relative_shift(particles, before, x);
    if (!(gap < pair.distance + travel + return_margin)) continue;
    LayerHit hit{pair.first, pair.second, 0, particles, gap, travel, pair.distance};
    hit.side = side_of(hit, before, x);
    if (!hit.side && !nearest.is_interior) continue;
    if (resolver && !hit.side &&
        are_intersecting(&particles[0], &particles[Kind::FIRST_PARTICLE_COUNT]) &&
        are_intersecting(&particles[Kind::FIRST_PARTICLE_COUNT],
                         particles.data() + particles.size()))
      continue;
    hits_.push_back(hit);
    if (hit.side) Kind::record_intersection(step_intersections_, hit.first, hit.second);
  }
  std::sort(step_intersections_.begin(), step_intersections_.end());
}

template <class Kind>
double LayerContacts<Kind>::relative_shift(const FourParticles& particles,
                                           const std::vector<double>& before,
                                           const std::vector<double>& x) {
  collide::Vec displacements[4];
  for (std::size_t k = 0; k < 4; ++k)
    displacements[k] = shapes::position_of(x.data(), particles[k]) -
                       shapes::position_of(before.data(), particles[k]);
  double max_square = 0;
  for (std::size_t i = 0; i < Kind::FIRST_PARTICLE_COUNT; ++i)
    for (std::size_t j = Kind::FIRST_PARTICLE_COUNT; j < 4; ++j) {
      const collide::Vec difference = displacements[i] - displacements[j];
      max_square = std::max(max_square, dot(difference, difference));
    }
  return std::sqrt(max_square);
}

template <class Kind>
std::int32_t LayerContacts<Kind>::side_of(const LayerHit& hit, const std::vector<double>& before,
                                          const std::vector<double>& x) const {
  const auto intersection = std::lower_bound(intersections.begin(), intersections.end(),
                                             Intersection{hit.first, hit.second, 0});
  if (intersection != intersections.end() && intersection->first == hit.first &&
      intersection->second == hit.second)
    return intersection->side;
  if (hit.gap > hit.relative_travel) return 0;
  return shapes::crossing_side(Shape(hit.particles.data(), before.data()),
                               Shape(hit.particles.data(), x.data()));
}

// Whether one element intersects a neighbour of the other, so that its side of the other is
// undefined.
template <class Kind>
bool LayerContacts<Kind>::is_next_to_intersection(const SpringLayers& layers,
                                                  const LayerHit& hit) const {
  const auto intersects = [&](std::int32_t element, const auto& is_neighbour) {
    auto intersection = std::lower_bound(step_intersections_.begin(), step_intersections_.end(),
                                         std::pair(element, -1));
    for (; intersection != step_intersections_.end() && intersection->first == element;
         ++intersection)
      if (is_neighbour(intersection->second)) return true;
    return false;
  };
  return Kind::is_next_to_intersection(layers, hit.first, hit.second, intersects);
}

template <class Kind>
void LayerContacts<Kind>::separate(const SpringLayers& layers, Separation& separation) const {
  for (const LayerHit& hit : hits_)
    if (hit.side || step_intersections_.empty() || !is_next_to_intersection(layers, hit))
      separation.separate<Shape>(hit);
}

template <class Kind>
void LayerContacts<Kind>::collect_tunnelling(const SpringLayers& layers,
                                             const std::vector<double>& from,
                                             const std::vector<double>& x,
                                             const std::vector<std::uint8_t>& is_moved,
                                             const IntersectionResolver& resolver,
                                             std::vector<LayerHit>& tunnelling) const {
  const auto are_intersecting = [&](const std::int32_t* first, const std::int32_t* last) {
    return std::all_of(first, last, [&](std::int32_t n) { return resolver.is_intersecting(n); });
  };
  for (const LayerPair& pair : near_pairs_) {
    const FourParticles particles = Kind::particles(layers, pair.first, pair.second);
    if (std::none_of(particles.begin(), particles.end(),
                     [&](std::int32_t n) { return is_moved[static_cast<std::size_t>(n)]; }))
      continue;
    if (!shapes::paths_overlap(particles.data(), Kind::FIRST_PARTICLE_COUNT, from.data(), x.data()))
      continue;
    const std::int32_t side = shapes::passing_side(Shape(particles.data(), from.data()),
                                                   Shape(particles.data(), x.data()));
    if (!side) continue;
    // Intersecting pairs have no known side.
    if (are_intersecting(&particles[0], &particles[Kind::FIRST_PARTICLE_COUNT]) &&
        are_intersecting(&particles[Kind::FIRST_PARTICLE_COUNT], particles.data() + 4))
      continue;
    tunnelling.push_back({pair.first, pair.second, side, particles, 0, 0, pair.distance});
  }
}

template <class Kind>
void LayerContacts<Kind>::drop_resolved(const SpringLayers& layers, const std::vector<double>& x) {
  std::erase_if(intersections, [&](const Intersection& intersection) {
    const Shape current(Kind::particles(layers, intersection.first, intersection.second).data(),
                        x.data());
    return !is_intersecting(intersection.side, current);
  });
}

template <class Kind>
void LayerContacts<Kind>::record_intersections(const std::vector<double>& before,
                                               const std::vector<double>& x) {
  intersections.clear();
  for (const LayerHit& hit : hits_) {
    if (!hit.side && hit.gap > 2 * hit.relative_travel) continue;
    const Shape current(hit.particles.data(), x.data());
    std::int32_t side = hit.side;
    if (side) {
      if (!is_intersecting(side, current)) side = 0;
    } else {
      side = shapes::crossing_side(Shape(hit.particles.data(), before.data()), current);
    }
    if (side) intersections.push_back({hit.first, hit.second, side});
  }
}

}  // namespace animtool
