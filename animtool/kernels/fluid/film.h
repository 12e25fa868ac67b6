// The free surface of a fluid: its area, and surface tension on particles.
//
// The area is the integral of the gradient magnitude of a colour function, which is 0 outside and 1
// inside (J. U. Brackbill, D. B. Kothe, C. Zemach, "A continuum method for modeling surface
// tension", 1992), on a grid with cubic B-splines. Forces are its gradient, so that tension has a
// potential and does not tear fluid apart: the colour rises fast where there is little fluid, and
// is uniform inside.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "colliders/colliders.h"

namespace animtool::fluid {

class FreeSurface {
 public:
  explicit FreeSurface(double spacing);

  // Lists the blocks of the grid that contain particles (rows of four numbers). The list is valid
  // until a particle moves by more than `LIST_MARGIN_RATIO` times the interaction radius.
  void list_blocks(const double* rows, std::size_t count);

  // Computes the area of the surface of the particles [m²], and its gradient.
  double compute_area(const double* rows, std::size_t count);

  // Adds the gradient of the area times a scale to displacements (rows of four numbers). The area
  // must have been computed at the same positions. The momentum and angular momentum of each drop
  // are conserved.
  void add_tension(const double* rows, std::size_t count, double scale, double* displacements);

 private:
  // Number of nodes along the side of a block, in a block, and along the side including the next
  // block.
  static constexpr int BLOCK_SIDE = 4, BLOCK_NODES = BLOCK_SIDE * BLOCK_SIDE * BLOCK_SIDE,
                       PADDED_SIDE = BLOCK_SIDE + 1;

  // Position of a particle in the grid: eight blocks, the first node in the first of them, and
  // spline weights with their derivatives.
  struct GridCell {
    std::int32_t blocks[8];
    int node[3];
    double weights[3][4], slopes[3][4];
  };

  // A drop: fluid without other fluid nearby.
  struct Drop {
    double count = 0;
    collide::Vec centre, mean_force, angular_correction;
    double inertia[6] = {};  // moments of inertia: xx, yy, zz, xy, xz, yz
  };

  // Locates a particle in the grid; returns false outside of the blocks.
  bool locate(const double* row, GridCell& cell) const;
  // Gradient of the area at a particle.
  collide::Vec compute_gradient(const GridCell& cell) const;
  void find_drops();
  void remove_net_forces(const double* rows);
  std::int32_t block_at(std::int64_t x, std::int64_t y, std::int64_t z) const;
  void add_block(std::int64_t x, std::int64_t y, std::int64_t z);
  void grow_table();
  double add_block_area(std::size_t block);

  const double cell_size_, inverse_volume_, min_gradient_;
  // Keys of the blocks, and a hash table of blocks by key. Block 0 is outside of the fluid and
  // stays empty.
  std::vector<std::array<std::int64_t, 3>> blocks_;
  std::vector<std::int32_t> block_table_;
  std::vector<std::int32_t>
      neighbour_blocks_;  // the eight neighbours of each block in positive directions, with itself
  std::vector<std::int32_t> drop_of_block_, drop_of_particle_;
  std::vector<Drop> drops_;
  std::vector<collide::Vec> tensions_;
  std::vector<double> colour_, colour_rates_, gradient_;
};

}  // namespace animtool::fluid
