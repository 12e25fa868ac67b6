// Interactions of neighbours in a fluid, four at a time.
#pragma once

#include <cstdint>

#include "base/wide.h"

namespace animtool {

// Rows of four numbers, with one extra row for a far padding particle. Each pair is listed once;
// partner lists are padded to a multiple of four.
struct FluidPairs {
  std::size_t count;
  const std::size_t* starts;
  const std::int32_t* partners;
  const double *points, *velocities;  // positions with multipliers
  double* factors;                    // of each pair: kernel derivative over the distance
  double *sums, *corrections;         // slopes and weights; displacements and virials
  double* squares;                    // of slopes
  double inverse, steep;              // 1 over the radius; the scale of slopes
  double damping;                     // of velocities
  double noise;                       // speed of particles that counts as rest
};

struct FluidFunctions {
  void (*measure_density)(const FluidPairs&);  // computes factors, adds to sums and squares
  void (*apply_viscosity)(const FluidPairs&);  // adds to displacements: viscosity
  void (*damp_noise)(const FluidPairs&);       // adds to displacements: noise damping
  void (*apply_pressure)(const FluidPairs&);   // adds to displacements: pressure multipliers
};
const FluidFunctions* fluid_in_quads();  // null where the processor has no such registers

template <class On>
struct FluidLoops {
  using D = Four<On>;

  // Visits each particle's partners, four at a time: position of the first, the rows from them to
  // it, and its update; partners take the opposite update, except the fourth number.
  template <class Do>
  static void for_each_pair(const FluidPairs& pairs, double* out, Do act) {
    for (std::size_t i = 0; i < pairs.count; ++i) {
      const double* at = pairs.points + 4 * i;
      const D here[4] = {at[0], at[1], at[2], at[3]};
      D sum[4] = {0.0, 0.0, 0.0, 0.0};
      for (std::size_t k = pairs.starts[i]; k < pairs.starts[i + 1]; k += WIDE) {
        D off[4], parts[4];
        gather(pairs.points, pairs.partners + k, off);
        for (std::size_t c = 0; c < 3; ++c) off[c] = here[c] - off[c];
        off[3] = here[3] + off[3];
        act(i, k, off, parts);
        for (std::size_t c = 0; c < 4; ++c) sum[c] = sum[c] + parts[c];
        scatter(parts, pairs.partners + k, out);
      }
      sum[3] = 0.0 - sum[3];
      (D::of(out + 4 * i) + totals(sum)).store(out + 4 * i);
    }
  }

  static D squares_of(const D* off) { return off[0] * off[0] + off[1] * off[1] + off[2] * off[2]; }

  static void measure_density(const FluidPairs& pairs) {
    const D inverse = pairs.inverse, steep = pairs.steep;
    for_each_pair(pairs, pairs.sums, [&](std::size_t i, std::size_t k, const D* off, D* parts) {
      const D squared = squares_of(off), q = sqrt(squared) * inverse;
      const D remaining = max(1.0 - q, 0.0), square = remaining * remaining;
      const D factor = steep * square * (6.0 - 5.0 * q);
      factor.store(pairs.factors + k);
      for (std::size_t c = 0; c < 3; ++c) parts[c] = factor * off[c];
      parts[3] = 0.0 - square * remaining * (1.0 + 3.0 * q * remaining);
      double squares[WIDE];
      (factor * factor * squared).store(squares);
      for (std::size_t c = 0; c < WIDE; ++c) pairs.squares[pairs.partners[k + c]] += squares[c];
      pairs.squares[i] += (squares[0] + squares[1]) + (squares[2] + squares[3]);
    });
  }

  // Brookshaw's Laplacian, of velocities.
  static void apply_viscosity(const FluidPairs& pairs) {
    const D viscous = pairs.damping;
    for_each_pair(pairs, pairs.corrections, [&](std::size_t i, std::size_t k, const D*, D* parts) {
      D there[4];
      gather(pairs.velocities, pairs.partners + k, there);
      const D across = viscous * D::of(pairs.factors + k);
      for (std::size_t c = 0; c < 3; ++c)
        parts[c] = across * (there[c] - pairs.velocities[4 * i + c]);
      parts[3] = 0.0;
    });
  }

  // Damps relative speeds along pairs that are as slow as particle noise. Momentum and spin are
  // conserved.
  static void damp_noise(const FluidPairs& pairs) {
    const D scale = pairs.damping, noise = pairs.noise * pairs.noise, none = 1e-300;
    for_each_pair(
        pairs, pairs.corrections, [&](std::size_t i, std::size_t k, const D* off, D* parts) {
          D there[4];
          gather(pairs.velocities, pairs.partners + k, there);
          D along = 0.0;
          for (std::size_t c = 0; c < 3; ++c)
            along = along + off[c] * (there[c] - pairs.velocities[4 * i + c]);
          const D slow = squares_of(off) * noise;
          along = scale * D::of(pairs.factors + k) * along * slow / (slow + along * along + none);
          for (std::size_t c = 0; c < 3; ++c) parts[c] = along * off[c];
          parts[3] = 0.0;
        });
  }

  // Half of a pair's pressure times its offset is the virial of each.
  static void apply_pressure(const FluidPairs& pairs) {
    for_each_pair(pairs, pairs.corrections,
                  [&](std::size_t, std::size_t k, const D* off, D* parts) {
                    const D push = off[3] * D::of(pairs.factors + k);
                    for (std::size_t c = 0; c < 3; ++c) parts[c] = push * off[c];
                    parts[3] = 0.0 - push * squares_of(off) * (0.5 / 3);
                  });
  }

  static constexpr FluidFunctions functions{measure_density, apply_viscosity, damp_noise,
                                            apply_pressure};
};

}  // namespace animtool
