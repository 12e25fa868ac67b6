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

// Indices of a triangle and a corner, or of two edges, the distance that they keep, and their gap.
struct LayerPair {
  std::int32_t first, second;
  double distance, gap;
};

using FourParticles = std::array<std::int32_t, 4>;
// Elements, and the elements that they pierce.
using Through = std::vector<std::pair<std::int32_t, std::int32_t>>;

// Triangles, and corners of others.
struct TrianglesAndCorners {
  using Shape = shapes::CornerPair;
  static constexpr std::size_t FIRST =
      1;  // number of the four particles that belong to the first element

  static FourParticles who(const SpringLayers& layers, std::int32_t triangle,
                           std::int32_t particle) {
    const std::int32_t* of = layers.corners(static_cast<std::size_t>(triangle));
    return {particle, of[0], of[1], of[2]};
  }
  // Records a piercing, and tests whether a pair is next to one.
  static void note(Through& through, std::int32_t triangle, std::int32_t particle) {
    through.push_back({particle, triangle});
  }
  template <class IsThrough>
  static bool is_next_to_crossed(const SpringLayers& layers, std::int32_t triangle,
                                 std::int32_t particle, IsThrough is_through) {
    return is_through(particle, [&](std::int32_t other) {
      const std::int32_t *one = layers.corners(static_cast<std::size_t>(triangle)),
                         *two = layers.corners(static_cast<std::size_t>(other));
      return std::find_first_of(one, one + 3, two, two + 3) != one + 3;
    });
  }
  // Pairs within a reach beyond their contact distance, sorted.
  static std::vector<LayerPair> near(const SpringLayers& layers, const std::vector<double>& x,
                                     double reach);
};

// Edges, and edges with a higher index.
struct EdgesAndEdges {
  using Shape = shapes::EdgePair;
  static constexpr std::size_t FIRST = 2;

  static FourParticles who(const SpringLayers& layers, std::int32_t first, std::int32_t second) {
    const std::int32_t *one = layers.ends(static_cast<std::size_t>(first)),
                       *other = layers.ends(static_cast<std::size_t>(second));
    return {one[0], one[1], other[0], other[1]};
  }
  static void note(Through& through, std::int32_t first, std::int32_t second) {
    through.push_back({first, second});
    through.push_back({second, first});
  }
  template <class IsThrough>
  static bool is_next_to_crossed(const SpringLayers& layers, std::int32_t first,
                                 std::int32_t second, IsThrough is_through) {
    const auto relative = [&](std::int32_t edge) {
      return [&layers, edge](std::int32_t other) {
        const std::int32_t *one = layers.ends(static_cast<std::size_t>(edge)),
                           *two = layers.ends(static_cast<std::size_t>(other));
        return std::find_first_of(one, one + 2, two, two + 2) != one + 2;
      };
    };
    return is_through(first, relative(second)) || is_through(second, relative(first));
  }
  static std::vector<LayerPair> near(const SpringLayers& layers, const std::vector<double>& x,
                                     double reach);
};

}  // namespace animtool
