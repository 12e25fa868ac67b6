// Interactions of neighbours in a fluid, four at a time.
#pragma once

#include <cstdint>

#include "base/wide.h"

namespace animtool {

// Neighbour pairs and arrays of particles: rows of four numbers, with one extra row for a distant
// padding particle. Each pair is listed once; partner lists are padded to a multiple of four.
struct FluidPairs {
  std::size_t count;
  const std::size_t* starts;
  const std::int32_t* partners;
  const double *points, *velocities;        // positions with pressure multipliers
  double* factors;                          // of each pair: kernel derivative over the distance
  double *sums, *corrections;               // gradients with weights; displacements with virials
  double* squared_gradients;                // of slopes
  double inverse_radius, derivative_scale;  // 1 over the radius; scale of kernel derivatives
  double damping;                           // factor of velocity damping
  double noise_speed;                       // relative speed that counts as noise
};

struct FluidFunctions {
  void (*measure_density)(
      const FluidPairs&);  // computes factors; adds to sums and squared gradients
  void (*apply_viscosity)(const FluidPairs&);  // adds velocity changes by viscosity to corrections
  void (*damp_noise)(const FluidPairs&);  // adds velocity changes by noise damping to corrections
  void (*apply_pressure)(const FluidPairs&);  // adds displacements by pressure to corrections
};
const FluidFunctions* fluid_in_quads();  // null if the processor has no such registers

template <class Simd>
struct FluidKernels {
  using D = Four<Simd>;

  // Calls `update` for the partners of each particle, four at a time, with the offsets from them to
  // the particle. It computes the changes of the particle; partners get the opposite changes,
  // except for the fourth number.
  template <class Update>
  static void for_each_pair(const FluidPairs& pairs, double* out, Update update) {
    for (std::size_t i = 0; i < pairs.count; ++i) {
      const double* row = pairs.points + 4 * i;
      const D position[4] = {row[0], row[1], row[2], row[3]};
      D sum[4] = {0.0, 0.0, 0.0, 0.0};
      for (std::size_t k = pairs.starts[i]; k < pairs.starts[i + 1]; k += SIMD_WIDTH) {
        D offsets[4], changes[4];
        gather(pairs.points, pairs.partners + k, offsets);
        for (std::size_t c = 0; c < 3; ++c) offsets[c] = position[c] - offsets[c];
        offsets[3] = position[3] + offsets[3];
        update(i, k, offsets, changes);
        for (std::size_t c = 0; c < 4; ++c) sum[c] = sum[c] + changes[c];
        scatter(changes, pairs.partners + k, out);
      }
      sum[3] = 0.0 - sum[3];
      (D::load(out + 4 * i) + totals(sum)).store(out + 4 * i);
    }
  }

  static D squared_lengths(const D* offsets) {
    return offsets[0] * offsets[0] + offsets[1] * offsets[1] + offsets[2] * offsets[2];
  }

  static void measure_density(const FluidPairs& pairs) {
    const D inverse_radius = pairs.inverse_radius, derivative_scale = pairs.derivative_scale;
    for_each_pair(pairs, pairs.sums,
                  [&](std::size_t i, std::size_t k, const D* offsets, D* changes) {
                    const D squared_length = squared_lengths(offsets),
                            q = sqrt(squared_length) * inverse_radius;
                    const D remaining = max(1.0 - q, 0.0), remaining_square = remaining * remaining;
                    const D factor = derivative_scale * remaining_square * (6.0 - 5.0 * q);
                    factor.store(pairs.factors + k);
                    for (std::size_t c = 0; c < 3; ++c) changes[c] = factor * offsets[c];
                    changes[3] = 0.0 - remaining_square * remaining * (1.0 + 3.0 * q * remaining);
                    double pair_squares[SIMD_WIDTH];
                    (factor * factor * squared_length).store(pair_squares);
                    for (std::size_t c = 0; c < SIMD_WIDTH; ++c)
                      pairs.squared_gradients[pairs.partners[k + c]] += pair_squares[c];
                    pairs.squared_gradients[i] +=
                        (pair_squares[0] + pair_squares[1]) + (pair_squares[2] + pair_squares[3]);
                  });
  }

  // Applies Brookshaw's Laplacian of velocities.
  static void apply_viscosity(const FluidPairs& pairs) {
    const D damping = pairs.damping;
    for_each_pair(pairs, pairs.corrections,
                  [&](std::size_t i, std::size_t k, const D*, D* changes) {
                    D partner_velocities[4];
                    gather(pairs.velocities, pairs.partners + k, partner_velocities);
                    const D factor = damping * D::load(pairs.factors + k);
                    for (std::size_t c = 0; c < 3; ++c)
                      changes[c] = factor * (partner_velocities[c] - pairs.velocities[4 * i + c]);
                    changes[3] = 0.0;
                  });
  }

  // Damps relative speeds of pairs that are as slow as particle noise. Momentum and angular
  // momentum are conserved.
  static void damp_noise(const FluidPairs& pairs) {
    const D scale = pairs.damping, noise = pairs.noise_speed * pairs.noise_speed, tiny = 1e-300;
    for_each_pair(
        pairs, pairs.corrections, [&](std::size_t i, std::size_t k, const D* offsets, D* changes) {
          D partner_velocities[4];
          gather(pairs.velocities, pairs.partners + k, partner_velocities);
          D approach = 0.0;
          for (std::size_t c = 0; c < 3; ++c)
            approach =
                approach + offsets[c] * (partner_velocities[c] - pairs.velocities[4 * i + c]);
          const D noise_square = squared_lengths(offsets) * noise;
          approach = scale * D::load(pairs.factors + k) * approach * noise_square /
                     (noise_square + approach * approach + tiny);
          for (std::size_t c = 0; c < 3; ++c) changes[c] = approach * offsets[c];
          changes[3] = 0.0;
        });
  }

  // The virial of each particle is half of a pair's pressure times its offset.
  static void apply_pressure(const FluidPairs& pairs) {
    for_each_pair(pairs, pairs.corrections,
                  [&](std::size_t, std::size_t k, const D* offsets, D* changes) {
                    const D pressure = offsets[3] * D::load(pairs.factors + k);
                    for (std::size_t c = 0; c < 3; ++c) changes[c] = pressure * offsets[c];
                    changes[3] = 0.0 - pressure * squared_lengths(offsets) * (0.5 / 3);
                  });
  }

  static constexpr FluidFunctions functions{measure_density, apply_viscosity, damp_noise,
                                            apply_pressure};
};

}  // namespace animtool
