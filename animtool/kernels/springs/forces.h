// The forces of springs on particles.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "springs/bands.h"
#include "springs/rows.h"

namespace animtool {

struct Spring {
  std::int32_t i, j;
  double rest, stiffness, damping, limit;  // limit: the length at which it tears
};

// Particles as columns, and the forces of springs between them.
struct ForceBuffers {
  std::vector<double> x, v, f, stored;
};

// Springs for force computation: bands of equal index offset where there are many, the others four
// at a time.
class SpringForces {
 public:
  SpringForces() = default;
  SpringForces(const std::vector<Spring>& springs, std::size_t particles);

  // Whether there are bands, and springs outside them.
  bool has_bands() const { return !pieces_.empty(); }
  bool has_unbanded() const { return !unbanded_.rest.empty(); }

  // Writes the forces on particles [N], in rows.
  void set(const double* x, const double* v, ForceBuffers& buffers, double* forces) const;

  // Adds the forces of springs outside bands.
  void add_unbanded(const double* x, const double* v, double* forces) const;

  // Advances particles in columns by a step, under the forces of the buffers and of bands; clears
  // the forces.
  void step(const PlaneSteps& steps, ForceBuffers& buffers) const;

  // Allocates buffers without forces; converts rows to columns, and back.
  void allocate(ForceBuffers& buffers) const;
  void read(const double* rows, std::vector<double>& columns) const;
  void write(const std::vector<double>& columns, double* rows) const;

 private:
  struct Numbers {
    std::vector<double> rest, stiffness, damping;

    void add(double length, double stiff, double damps);
  };
  // Springs from particles first to last, in multiples of four, to those an offset later.
  struct Band {
    std::size_t offset, first, last;
    Numbers numbers;
  };

  static Band band_of(const std::vector<Spring>& springs, const std::vector<std::size_t>& chosen);
  std::vector<Band> build_bands(const std::vector<Spring>& springs,
                                std::vector<std::size_t>& banded) const;
  void build_pieces(std::vector<Band> bands);
  void build_piece(std::size_t begin, std::size_t end, std::vector<const Band*> bands);
  BandPieces pieces() const;
  BandPlanes planes(ForceBuffers& buffers) const;

  std::size_t particles_ = 0;
  std::vector<BandPiece> pieces_;
  std::size_t max_offsets_ = 0;  // of a piece
  std::vector<std::size_t> offsets_;
  std::vector<double> numbers_;
  Numbers unbanded_;
  std::vector<std::int32_t> unbanded_ends_;
};

}  // namespace animtool
