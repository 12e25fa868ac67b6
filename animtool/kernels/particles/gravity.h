// N-body gravity: sums over several targets at a time.
#pragma once

#include <cstddef>

namespace animtool {

// Number of targets that are summed at the same time.
constexpr std::size_t GRAVITY_WIDTH = 8;
// Numbers of a distant cell: centre of mass relative to the group, mass, and second moments about
// the centre of mass: xx, xy, xz, yy, yz, zz.
constexpr std::size_t FAR_CELL_SIZE = 10;

// Positions and masses of targets, and their positions relative to the centre of a group.
struct GravityTargets {
  double x[GRAVITY_WIDTH], y[GRAVITY_WIDTH], z[GRAVITY_WIDTH], mass[GRAVITY_WIDTH];
  float from_centre[3][GRAVITY_WIDTH];
};
// Accelerations, negative potentials, and the largest squared frequency of a pair.
struct GravitySums {
  double x[GRAVITY_WIDTH], y[GRAVITY_WIDTH], z[GRAVITY_WIDTH], potential[GRAVITY_WIDTH];
  double max_squared_frequency[GRAVITY_WIDTH];
};
// Positions and masses of all bodies.
struct GravityBodies {
  const double *x, *y, *z, *mass;
};
// A range of bodies.
struct BodyRange {
  std::size_t begin, end;
};

struct GravityFunctions {
  // Pairs in float64, from an inverse square root in float32 that is refined.
  void (*sum_pairs_double)(const GravityBodies& bodies, BodyRange run, double squared_softening,
                           const GravityTargets& targets, GravitySums& sums);
  // Pairs with distances in float64 and forces in float32.
  void (*sum_pairs_float)(const GravityBodies& bodies, BodyRange run, double squared_softening,
                          const GravityTargets& targets, GravitySums& sums);
  // Cells by their monopole and quadrupole, in float32.
  void (*sum_cells)(const float* cells, std::size_t count, float squared_softening,
                    const GravityTargets& targets, GravitySums& sums);
};
// Null if the processor has no such registers.
const GravityFunctions* gravity_in_quads();

}  // namespace animtool
