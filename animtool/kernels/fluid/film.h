// The free surface of a fluid: its area, and surface tension on particles.
//
// The area is the integral of the gradient magnitude of a colour function, which is 0 outside and 1
// inside (J. U. Brackbill, D. B. Kothe, C. Zemach, "A continuum method for modeling surface
// tension", 1992), on a grid with cubic B-splines. Forces are its gradient, so that tension has a
// potential and tears nothing off: the colour rises fast where there is little fluid, and is
// uniform inside.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "colliders/colliders.h"

namespace animtool::fluid {

class Film {
 public:
  explicit Film(double spacing);

  // Finds the blocks of the grid with particles, four numbers each; valid until a particle moves by
  // more than `SKIN` of the radius of sight.
  void list(const double* rows, std::size_t count);

  // Area around particles [m²].
  double measure(const double* rows, std::size_t count);

  // Adds the gradient of the area times a scale to displacements, four numbers each; the area was
  // measured at the same positions. Momentum and spin of each drop are conserved.
  void pull(const double* rows, std::size_t count, double scale, double* moved);

 private:
  // Nodes along the sides of a block, in all of it, and with those of the next blocks.
  static constexpr int SIDE = 4, NODES = SIDE * SIDE * SIDE, WIDER = SIDE + 1;

  // Position of a particle in the grid: eight blocks, the node in the first, and weights.
  struct Spot {
    std::int32_t blocks[8];
    int node[3];
    double weights[3][4], slopes[3][4];
  };

  // A drop: fluid without other fluid nearby.
  struct Drop {
    double count = 0;
    collide::Vec centre, push, moment;
    double turning[6] = {};  // moments of inertia: xx, yy, zz, xy, xz, yz
  };

  bool find(const double* row, Spot& spot) const;
  collide::Vec slope_at(const Spot& spot) const;
  void part_drops();
  void balance(const double* rows);
  std::int32_t block_at(std::int64_t x, std::int64_t y, std::int64_t z) const;
  void add_block(std::int64_t x, std::int64_t y, std::int64_t z);
  void grow();
  double steepen(std::size_t block);

  const double cell_, share_, soft_;
  // Block 0 is outside and stays empty. Keys, and a hash table of blocks by key.
  std::vector<std::array<std::int64_t, 3>> blocks_;
  std::vector<std::int32_t> table_;
  std::vector<std::int32_t> after_;  // the eight neighbours of each block
  std::vector<std::int32_t> drop_of_block_, drop_of_;
  std::vector<Drop> drops_;
  std::vector<collide::Vec> pulls_;
  std::vector<double> colour_, rising_, slopes_;
};

}  // namespace animtool::fluid
