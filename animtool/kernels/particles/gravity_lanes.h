// Sums of gravity, eight numbers at a time.
#pragma once

#include <algorithm>

#include "base/wide.h"
#include "particles/gravity.h"

namespace animtool {

// Number of sources after which float32 sums are added to float64 sums.
constexpr std::size_t MAX_FLOAT_SUM_TERMS = 64;
// Bodies closer than this squared distance are coincident, and do not interact.
constexpr float MIN_SQUARED_DISTANCE = 1e-37f;

template <class Simd>
struct GravityKernels {
  using F = Wide<float, GRAVITY_WIDTH, Simd>;
  using D = Wide<double, GRAVITY_WIDTH, Simd>;

  // Adds to sums in memory, or takes the maximum.
  static void add_to_sum(const D& a, double* sum) { (D::load(sum) + a).store(sum); }
  static void store_max(const D& a, double* sum) { max(D::load(sum), a).store(sum); }
  static F inverse_root(const F& a) { return 1.0f / sqrt(a); }
  // Returns a value, or 0 if two bodies coincide.
  static F zero_if_coincident(const F& squared_distance, const F& value) {
    return masked(less(MIN_SQUARED_DISTANCE, squared_distance), value);
  }

  // Sums over several sources, in either precision.
  template <class T>
  struct PartialSums {
    T x = 0.0f, y = x, z = x, potential = x, max_squared_frequency = x;

    void add_pair(const T (&offset)[3], const T& mass, const T& target_mass, const T& inverse) {
      const T inverse_cube = inverse * inverse * inverse, factor = mass * inverse_cube;
      x = x + factor * offset[0];
      y = y + factor * offset[1];
      z = z + factor * offset[2];
      potential = potential + mass * inverse;
      max_squared_frequency = max(max_squared_frequency, (mass + target_mass) * inverse_cube);
    }
    void add_to(GravitySums& sums) const {
      add_to_sum(D(x), sums.x);
      add_to_sum(D(y), sums.y);
      add_to_sum(D(z), sums.z);
      add_to_sum(D(potential), sums.potential);
      store_max(D(max_squared_frequency), sums.max_squared_frequency);
    }
  };

  static void sum_pairs_double(const GravityBodies& bodies, BodyRange run, double squared_softening,
                               const GravityTargets& targets, GravitySums& sums) {
    const D position[3] = {D::load(targets.x), D::load(targets.y), D::load(targets.z)},
            target_mass = D::load(targets.mass), softening = squared_softening;
    PartialSums<D> partial_sums;
    for (std::size_t j = run.begin; j < run.end; ++j) {
      const D offset[3] = {D(bodies.x[j]) - position[0], D(bodies.y[j]) - position[1],
                           D(bodies.z[j]) - position[2]};
      const D squared_distance =
          offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2];
      const D softened_square = squared_distance + softening;
      const F rough_inverse_distance = inverse_root(F(softened_square));
      const D inverse_distance = D(zero_if_coincident(F(squared_distance), rough_inverse_distance));
      // Halley's third-order step: from seven digits to full precision.
      const D residual = 1.0 - softened_square * inverse_distance * inverse_distance;
      partial_sums.add_pair(
          offset, bodies.mass[j], target_mass,
          inverse_distance + inverse_distance * residual * (0.5 + 0.375 * residual));
    }
    partial_sums.add_to(sums);
  }

  static void sum_pairs_float(const GravityBodies& bodies, BodyRange run, double squared_softening,
                              const GravityTargets& targets, GravitySums& sums) {
    const D position[3] = {D::load(targets.x), D::load(targets.y), D::load(targets.z)};
    const F target_mass = F(D::load(targets.mass)),
            softening = static_cast<float>(squared_softening);
    for (std::size_t first = run.begin; first < run.end; first += MAX_FLOAT_SUM_TERMS) {
      PartialSums<F> partial_sums;
      for (std::size_t j = first; j < std::min(run.end, first + MAX_FLOAT_SUM_TERMS); ++j) {
        const F offset[3] = {F(D(bodies.x[j]) - position[0]), F(D(bodies.y[j]) - position[1]),
                             F(D(bodies.z[j]) - position[2])};
        const F squared_distance =
            offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2];
        const F inverse = inverse_root(squared_distance + softening);
        partial_sums.add_pair(offset, static_cast<float>(bodies.mass[j]), target_mass,
                              zero_if_coincident(squared_distance, inverse));
      }
      partial_sums.add_to(sums);
    }
  }

  // The potential 1/s with s² = r² + ε², expanded to second order about the centre of mass.
  static void sum_cells(const float* cells, std::size_t count, float squared_softening,
                        const GravityTargets& targets, GravitySums& sums) {
    const F position[3] = {F::load(targets.from_centre[0]), F::load(targets.from_centre[1]),
                           F::load(targets.from_centre[2])};
    const F softening = squared_softening;
    for (std::size_t first = 0; first < count; first += MAX_FLOAT_SUM_TERMS) {
      PartialSums<F> partial_sums;
      for (std::size_t j = first; j < std::min(count, first + MAX_FLOAT_SUM_TERMS); ++j) {
        const float* cell = cells + FAR_CELL_SIZE * j;
        const F x = F(cell[0]) - position[0], y = F(cell[1]) - position[1];
        const F z = F(cell[2]) - position[2];
        const F xx = cell[4], xy = cell[5], xz = cell[6];
        const F yy = cell[7], yz = cell[8], zz = cell[9];
        const F inverse = inverse_root(x * x + y * y + z * z + softening);
        const F inverse_square = inverse * inverse, mass = F(cell[3]) * inverse;
        const F qx = xx * x + xy * y + xz * z, qy = xy * x + yy * y + yz * z;
        const F qz = xz * x + yz * y + zz * z;
        const F inverse_fifth = inverse_square * inverse_square * inverse;
        const F quadrupole = (qx * x + qy * y + qz * z) * inverse_square, trace = xx + yy + zz;
        const F radial = mass * inverse_square + inverse_fifth * (7.5f * quadrupole - 1.5f * trace);
        const F outward = 3.0f * inverse_fifth;
        partial_sums.x = partial_sums.x + (radial * x - outward * qx);
        partial_sums.y = partial_sums.y + (radial * y - outward * qy);
        partial_sums.z = partial_sums.z + (radial * z - outward * qz);
        partial_sums.potential = partial_sums.potential + mass +
                                 inverse_square * inverse * (1.5f * quadrupole - 0.5f * trace);
      }
      partial_sums.add_to(sums);
    }
  }

  static constexpr GravityFunctions functions{sum_pairs_double, sum_pairs_float, sum_cells};
};

}  // namespace animtool
