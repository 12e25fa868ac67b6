// N-body gravity: sums over lanes of targets.
#pragma once

#include <cstddef>

namespace animtool {

// Targets summed at once.
constexpr std::size_t GRAVITY_WIDTH = 8;
// Numbers of a distant cell: centre of mass relative to the group, mass, and second moments about
// the centre: xx, xy, xz, yy, yz, zz.
constexpr std::size_t GRAVITY_FAR = 10;

struct GravityTargets {
  double x[GRAVITY_WIDTH], y[GRAVITY_WIDTH], z[GRAVITY_WIDTH], mass[GRAVITY_WIDTH];
  float from_middle[3][GRAVITY_WIDTH];
};
// Accelerations, potentials without their sign, and the largest squared frequency of a pair.
struct GravitySums {
  double x[GRAVITY_WIDTH], y[GRAVITY_WIDTH], z[GRAVITY_WIDTH], potential[GRAVITY_WIDTH];
  double rate[GRAVITY_WIDTH];
};
struct GravityBodies {
  const double *x, *y, *z, *mass;
};
struct GravityRun {
  std::size_t begin, end;
};

struct GravityFunctions {
  // Pairs in float64, from a root in float32 that is refined.
  void (*exact)(const GravityBodies& bodies, GravityRun run, double softened,
                const GravityTargets& targets, GravitySums& sums);
  // Pairs whose distances are float64 and whose forces are float32.
  void (*near)(const GravityBodies& bodies, GravityRun run, double softened,
               const GravityTargets& targets, GravitySums& sums);
  // Cells by their monopole and quadrupole, in float32.
  void (*far)(const float* cells, std::size_t count, float softened, const GravityTargets& targets,
              GravitySums& sums);
};
// Null where the processor has no such registers.
const GravityFunctions* gravity_in_quads();

}  // namespace animtool
