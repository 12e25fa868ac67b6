// Forces between molecules, four at a time.
#pragma once

#include <cmath>

#include "base/wide.h"
#include "particles/molecules.h"

namespace animtool {

// Rounds to the nearest whole number when added and subtracted.
constexpr double MOLECULE_ROUND = 6755399441055744.0;
constexpr double ROOT_PI = 1.7724538509055160273;

template <class On>
struct MoleculeLoops {
  using D = Four<On>;

  // Shared by all pairs.
  struct PairLaw {
    D cutoff, from, width, box[3], inverse_box[3];
    double shift, slope, damping, cutoff_distance;

    explicit PairLaw(const MoleculeSystem& system) : cutoff(system.cutoff), from(system.from) {
      const double gap = system.cutoff - system.from;
      width = gap > 0 ? 1 / (gap * gap * gap) : 0.0;
      for (std::size_t k = 0; k < 3; ++k)
        box[k] = system.box[k], inverse_box[k] = 1 / system.box[k];
      damping = system.damping;
      cutoff_distance = std::sqrt(system.cutoff);
      shift = std::erfc(damping * cutoff_distance) / cutoff_distance;
      slope = shift / cutoff_distance + 2 * damping / ROOT_PI *
                                            std::exp(-damping * damping * system.cutoff) /
                                            cutoff_distance;
    }
  };

  // Energy of two unit charges, and force over distance: damped, shifted to 0 at the cut-off with
  // the force. C. J. Fennell, J. D. Gezelter, Journal of Chemical Physics 124, 2006.
  static void coulomb(const PairLaw& law, double squared, double& energy, double& force) {
    const double r = std::sqrt(squared), decay = std::erfc(law.damping * r) / r;
    const double bend = 2 * law.damping / ROOT_PI * std::exp(-law.damping * law.damping * squared);
    energy = decay - law.shift + law.slope * (r - law.cutoff_distance);
    force = (decay / r + bend / r - law.slope) / r;
  }

  template <bool switched, bool several, bool charged>
  static double add_pairs(const MoleculeSystem& system, double* out) {
    const PairLaw law(system);
    const D round = MOLECULE_ROUND;
    D virial = 0.0;
    D c12 = system.forces[0].twelve, c6 = system.forces[0].six;
    for (std::size_t i = 0; i < system.count; ++i) {
      const double* at = system.rows + 4 * i;
      const D here[3] = {at[0], at[1], at[2]};
      D sum[4] = {0.0, 0.0, 0.0, 0.0};
      const MoleculeForce* forces =
          several ? system.forces + static_cast<std::size_t>(system.kind[i]) * system.kinds
                  : system.forces;
      const std::int32_t* end = system.partners + system.starts[i + 1];
      for (const std::int32_t* j = system.partners + system.starts[i]; j < end; j += WIDE) {
        D off[4];
        gather(system.rows, j, off);
        D squared = 0.0;
        for (std::size_t k = 0; k < 3; ++k) {
          const D displacement = here[k] - off[k];
          off[k] =
              displacement - law.box[k] * ((displacement * law.inverse_box[k] + round) - round);
          squared = squared + off[k] * off[k];
        }
        const D in_range = less(squared, law.cutoff);
        if (!mask_bits(in_range)) continue;
        if constexpr (several) {
          double twelves[WIDE], sixes[WIDE];
          for (std::size_t k = 0; k < WIDE; ++k) {
            const MoleculeForce& force = forces[system.kind[j[k]]];
            twelves[k] = force.twelve, sixes[k] = force.six;
          }
          c12 = D::of(twelves), c6 = D::of(sixes);
        }
        const D inverse = 1.0 / squared, inverse_cubed = inverse * inverse * inverse;
        const D repels = c12 * inverse_cubed * inverse_cubed, attracts = c6 * inverse_cubed;
        D energy = repels - attracts;
        D force = 6.0 * inverse * (repels + energy);
        if constexpr (switched) {
          const D far = max(squared, law.from), remaining = law.cutoff - far;
          const D switching =
              remaining * remaining * (law.cutoff + 2.0 * far - 3.0 * law.from) * law.width;
          const D bend = 12.0 * remaining * (far - law.from) * law.width;
          force = switching * force + bend * energy;
          energy = switching * energy;
        }
        if constexpr (charged) {
          double squares[WIDE], energies[WIDE], pulls[WIDE];
          squared.store(squares);
          for (std::size_t k = 0; k < WIDE; ++k) {
            energies[k] = pulls[k] = 0;
            const double charge_product = system.charges[i] * system.charges[j[k]];
            if (charge_product == 0 || !(squares[k] < system.cutoff)) continue;
            coulomb(law, squares[k], energies[k], pulls[k]);
            energies[k] *= charge_product, pulls[k] *= charge_product;
          }
          energy = energy + D::of(energies);
          force = force + D::of(pulls);
        }
        force = masked(in_range, force);
        energy = masked(in_range, 0.5 * energy);
        virial = virial + masked(in_range, force * squared);
        D parts[4] = {force * masked(in_range, off[0]), force * masked(in_range, off[1]),
                      force * masked(in_range, off[2]), 0.0 - energy};
        for (std::size_t k = 0; k < 4; ++k) sum[k] = sum[k] + parts[k];
        scatter(parts, j, out);
      }
      for (std::size_t k = 0; k < 4; ++k) out[4 * i + k] += k < 3 ? total(sum[k]) : -total(sum[k]);
    }
    return total(virial);
  }

  template <bool switched>
  static double of_kinds(const MoleculeSystem& system, double* out) {
    if (system.charges) return add_pairs<switched, true, true>(system, out);
    return system.kinds > 1 ? add_pairs<switched, true, false>(system, out)
                            : add_pairs<switched, false, false>(system, out);
  }

  static double run(const MoleculeSystem& system, double* out) {
    return system.from < system.cutoff ? of_kinds<true>(system, out) : of_kinds<false>(system, out);
  }
};

}  // namespace animtool
