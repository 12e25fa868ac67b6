// Forces between neighbouring molecules, four partners at a time.
#pragma once

#include <cstddef>
#include <cstdint>

namespace animtool {

// Lennard-Jones coefficients of c12/r¹² - c6/r⁶.
struct MoleculeForce {
  double c12, c6;
};
// A system of molecules. Rows of four numbers hold positions, and one extra padding row is far
// away. Partner lists are padded to a multiple of four.
struct MoleculeSystem {
  std::size_t count, kind_count;
  const double* rows;
  const std::int64_t* starts;
  const std::int32_t* partners;
  const std::int32_t* kinds;
  const MoleculeForce* forces;  // for each pair of kinds
  const double* charges;  // multiplied by the root of Coulomb's constant; null without charges
  double box[3];
  double squared_cutoff, squared_onset;  // squared cut-off distance, and squared distance at which
                                         // the switching function begins
  double damping;
};

// Adds forces and half the pair energies to rows of four numbers. Returns the virial of all pairs.
using MoleculeFunction = double (*)(const MoleculeSystem& system, double* out);
MoleculeFunction molecules_in_quads();  // null if the processor has no registers of four doubles

}  // namespace animtool
