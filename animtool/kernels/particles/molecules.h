// Forces between neighbouring molecules: four partners at a time.
#pragma once

#include <cstddef>
#include <cstdint>

namespace animtool {

// Lennard-Jones coefficients: c12/r¹² - c6/r⁶.
struct MoleculeForce {
  double twelve, six;
};
// Rows of four numbers: positions, and forces with half the pair energies; one extra padding row
// far away. Partner lists are padded to a multiple of four.
struct MoleculeSystem {
  std::size_t count, kinds;
  const double* rows;
  const std::int64_t* starts;
  const std::int32_t* partners;
  const std::int32_t* kind;
  const MoleculeForce* forces;  // of each pair of kinds
  const double* charges;        // times the root of Coulomb's constant; null of none
  double box[3];
  double cutoff, from;  // squared cut-off, and squared start of the switch
  double damping;
};

// Adds to the rows of forces; returns the virial of all pairs.
using MoleculeFunction = double (*)(const MoleculeSystem& system, double* out);
MoleculeFunction molecules_in_quads();  // null where the processor has no such registers

}  // namespace animtool
