// Forces between molecules, four at a time.
#pragma once

#include <cmath>

#include "base/wide.h"
#include "particles/molecules.h"

namespace animtool {

// Rounds to the nearest whole number when added and subtracted.
constexpr double ROUNDING_CONSTANT = 6755399441055744.0;
constexpr double SQRT_PI = 1.7724538509055160273;

template <class Simd>
struct MoleculeKernels {
  using D = Four<Simd>;

  // Quantities that all pairs share.
  struct PairLaw {
    D squared_cutoff, squared_onset, inverse_cubed_switch_width, box[3], inverse_box[3];
    double energy_shift, force_at_cutoff, damping, cutoff_distance;

    explicit PairLaw(const MoleculeSystem& system)
        : squared_cutoff(system.squared_cutoff), squared_onset(system.squared_onset) {
      const double switch_width = system.squared_cutoff - system.squared_onset;
      inverse_cubed_switch_width =
          switch_width > 0 ? 1 / (switch_width * switch_width * switch_width) : 0.0;
      for (std::size_t k = 0; k < 3; ++k)
        box[k] = system.box[k], inverse_box[k] = 1 / system.box[k];
      damping = system.damping;
      cutoff_distance = std::sqrt(system.squared_cutoff);
      energy_shift = std::erfc(damping * cutoff_distance) / cutoff_distance;
      force_at_cutoff = energy_shift / cutoff_distance +
                        2 * damping / SQRT_PI *
                            std::exp(-damping * damping * system.squared_cutoff) / cutoff_distance;
    }
  };

  // Computes the energy of two unit charges, and their force over their distance. Both are damped,
  // and shifted so that they are 0 at the cut-off.
  // C. J. Fennell, J. D. Gezelter, Is the Ewald summation still necessary?, Journal of Chemical
  // Physics 124, 2006.
  static void coulomb(const PairLaw& law, double squared_distance, double& energy, double& force) {
    const double distance = std::sqrt(squared_distance),
                 damped_energy = std::erfc(law.damping * distance) / distance;
    const double damping_slope =
        2 * law.damping / SQRT_PI * std::exp(-law.damping * law.damping * squared_distance);
    energy =
        damped_energy - law.energy_shift + law.force_at_cutoff * (distance - law.cutoff_distance);
    force = (damped_energy / distance + damping_slope / distance - law.force_at_cutoff) / distance;
  }

  template <bool uses_switching, bool has_kinds, bool has_charges>
  static double add_pairs(const MoleculeSystem& system, double* out) {
    const PairLaw law(system);
    const D rounding = ROUNDING_CONSTANT;
    D virial = 0.0;
    D c12 = system.forces[0].c12, c6 = system.forces[0].c6;
    for (std::size_t i = 0; i < system.count; ++i) {
      const double* row = system.rows + 4 * i;
      const D position[3] = {row[0], row[1], row[2]};
      D sum[4] = {0.0, 0.0, 0.0, 0.0};
      const MoleculeForce* forces =
          has_kinds ? system.forces + static_cast<std::size_t>(system.kinds[i]) * system.kind_count
                    : system.forces;
      const std::int32_t* end = system.partners + system.starts[i + 1];
      for (const std::int32_t* partner = system.partners + system.starts[i]; partner < end;
           partner += SIMD_WIDTH) {
        D offsets[4];
        gather(system.rows, partner, offsets);
        D squared_distance = 0.0;
        for (std::size_t k = 0; k < 3; ++k) {
          const D displacement = position[k] - offsets[k];
          offsets[k] = displacement -
                       law.box[k] * ((displacement * law.inverse_box[k] + rounding) - rounding);
          squared_distance = squared_distance + offsets[k] * offsets[k];
        }
        const D is_in_range = less(squared_distance, law.squared_cutoff);
        if (!mask_bits(is_in_range)) continue;
        if constexpr (has_kinds) {
          double repulsions[SIMD_WIDTH], attractions[SIMD_WIDTH];
          for (std::size_t k = 0; k < SIMD_WIDTH; ++k) {
            const MoleculeForce& force = forces[system.kinds[partner[k]]];
            repulsions[k] = force.c12, attractions[k] = force.c6;
          }
          c12 = D::load(repulsions), c6 = D::load(attractions);
        }
        const D inverse_squared = 1.0 / squared_distance,
                inverse_sixth = inverse_squared * inverse_squared * inverse_squared;
        const D repulsion = c12 * inverse_sixth * inverse_sixth, attraction = c6 * inverse_sixth;
        D energy = repulsion - attraction;
        D force = 6.0 * inverse_squared * (repulsion + energy);
        if constexpr (uses_switching) {
          const D clamped_square = max(squared_distance, law.squared_onset),
                  remaining = law.squared_cutoff - clamped_square;
          const D switching =
              remaining * remaining *
              (law.squared_cutoff + 2.0 * clamped_square - 3.0 * law.squared_onset) *
              law.inverse_cubed_switch_width;
          const D switching_slope = 12.0 * remaining * (clamped_square - law.squared_onset) *
                                    law.inverse_cubed_switch_width;
          force = switching * force + switching_slope * energy;
          energy = switching * energy;
        }
        if constexpr (has_charges) {
          double squared_distances[SIMD_WIDTH], energies[SIMD_WIDTH],
              forces_over_distance[SIMD_WIDTH];
          squared_distance.store(squared_distances);
          for (std::size_t k = 0; k < SIMD_WIDTH; ++k) {
            energies[k] = forces_over_distance[k] = 0;
            const double charge_product = system.charges[i] * system.charges[partner[k]];
            if (charge_product == 0 || !(squared_distances[k] < system.squared_cutoff)) continue;
            coulomb(law, squared_distances[k], energies[k], forces_over_distance[k]);
            energies[k] *= charge_product, forces_over_distance[k] *= charge_product;
          }
          energy = energy + D::load(energies);
          force = force + D::load(forces_over_distance);
        }
        force = masked(is_in_range, force);
        energy = masked(is_in_range, 0.5 * energy);
        virial = virial + masked(is_in_range, force * squared_distance);
        D changes[4] = {force * masked(is_in_range, offsets[0]),
                        force * masked(is_in_range, offsets[1]),
                        force * masked(is_in_range, offsets[2]), 0.0 - energy};
        for (std::size_t k = 0; k < 4; ++k) sum[k] = sum[k] + changes[k];
        scatter(changes, partner, out);
      }
      for (std::size_t k = 0; k < 4; ++k) out[4 * i + k] += k < 3 ? total(sum[k]) : -total(sum[k]);
    }
    return total(virial);
  }

  template <bool uses_switching>
  static double add_for_kinds(const MoleculeSystem& system, double* out) {
    if (system.charges) return add_pairs<uses_switching, true, true>(system, out);
    return system.kind_count > 1 ? add_pairs<uses_switching, true, false>(system, out)
                                 : add_pairs<uses_switching, false, false>(system, out);
  }

  // Adds forces and half the pair energies to rows of four numbers; returns the virial.
  static double add_forces(const MoleculeSystem& system, double* out) {
    return system.squared_onset < system.squared_cutoff ? add_for_kinds<true>(system, out)
                                                        : add_for_kinds<false>(system, out);
  }
};

}  // namespace animtool
