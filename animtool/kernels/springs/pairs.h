// Broad phase of self-contact.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "springs/layers.h"
#include "springs/shapes.h"

namespace animtool {

// A triangle and a corner, or two edges: their indices, the distance that they keep, and their gap.
struct LayerPair {
  std::int32_t first, second;
  double distance, gap;
};

using FourParticles = std::array<std::int32_t, 4>;
// Elements, each with an element that it crosses; sorted.
using Intersections = std::vector<std::pair<std::int32_t, std::int32_t>>;

// Triangles, and corners of other triangles.
struct TrianglesAndCorners {
  using Shape = shapes::CornerPair;
  static constexpr std::size_t FIRST_PARTICLE_COUNT =
      1;  // number of the four particles that belong to the first element

  static FourParticles particles(const SpringLayers& layers, std::int32_t triangle,
                                 std::int32_t particle) {
    const std::int32_t* corners = layers.corners(static_cast<std::size_t>(triangle));
    return {particle, corners[0], corners[1], corners[2]};
  }
  // Records an intersection, and tests whether a pair is next to one.
  static void record_intersection(Intersections& intersections, std::int32_t triangle,
                                  std::int32_t particle) {
    intersections.push_back({particle, triangle});
  }
  template <class Intersects>
  static bool is_next_to_intersection(const SpringLayers& layers, std::int32_t triangle,
                                      std::int32_t particle, Intersects intersects) {
    return intersects(particle, [&](std::int32_t other) {
      const std::int32_t *corners = layers.corners(static_cast<std::size_t>(triangle)),
                         *other_corners = layers.corners(static_cast<std::size_t>(other));
      return std::find_first_of(corners, corners + 3, other_corners, other_corners + 3) !=
             corners + 3;
    });
  }
  // Pairs that are closer than their contact distance plus a margin, sorted.
  static std::vector<LayerPair> find_near(const SpringLayers& layers, const std::vector<double>& x,
                                          double margin);
};

// Edges, and edges with a higher index.
struct EdgesAndEdges {
  using Shape = shapes::EdgePair;
  static constexpr std::size_t FIRST_PARTICLE_COUNT = 2;

  static FourParticles particles(const SpringLayers& layers, std::int32_t first,
                                 std::int32_t second) {
    const std::int32_t *first_ends = layers.ends(static_cast<std::size_t>(first)),
                       *second_ends = layers.ends(static_cast<std::size_t>(second));
    return {first_ends[0], first_ends[1], second_ends[0], second_ends[1]};
  }
  static void record_intersection(Intersections& intersections, std::int32_t first,
                                  std::int32_t second) {
    intersections.push_back({first, second});
    intersections.push_back({second, first});
  }
  template <class Intersects>
  static bool is_next_to_intersection(const SpringLayers& layers, std::int32_t first,
                                      std::int32_t second, Intersects intersects) {
    const auto touches_edge = [&](std::int32_t edge) {
      return [&layers, edge](std::int32_t other) {
        const std::int32_t *ends = layers.ends(static_cast<std::size_t>(edge)),
                           *other_ends = layers.ends(static_cast<std::size_t>(other));
        return std::find_first_of(ends, ends + 2, other_ends, other_ends + 2) != ends + 2;
      };
    };
    return intersects(first, touches_edge(second)) || intersects(second, touches_edge(first));
  }
  static std::vector<LayerPair> find_near(const SpringLayers& layers, const std::vector<double>& x,
                                          double margin);
};

}  // namespace animtool
