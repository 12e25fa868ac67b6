// Molecules that act on their neighbours: four partners of one side by side.
#pragma once

#include <cstddef>
#include <cstdint>

namespace animtool {

// What acts between two, beside charges: c12/r¹² - c6/r⁶.
struct MoleculeForce {
  double twelve, six;
};
// Rows of four numbers: where each is, and forces with half the energies of pairs; one more
// row than there are molecules, of one that is nowhere. Partners of one molecule are a multiple
// of four, filled up with that one.
struct MoleculeSystem {
  std::size_t count, kinds;
  const double* rows;
  const std::int64_t* starts;
  const std::int32_t* partners;
  const std::int32_t* kind;
  const MoleculeForce* forces;  // of each pair of kinds
  const double* charges;        // times the root of Coulomb's constant; null of none
  double box[3];
  double cutoff, from;  // squares of distances: none beyond, and less from here on
  double damping;
};

// Adds to the rows of forces; returns the sum of what all pairs do along their distance.
using MoleculeFunction = double (*)(const MoleculeSystem& system, double* out);
MoleculeFunction molecules_in_quads();  // null where the processor has no such registers

}  // namespace animtool
