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

// Columns of particles, and room for the forces between them.
struct ForceBuffers {
  std::vector<double> x, v, f, stored;
};

// What forces need to know of springs: in bands where many lie alike, the others in fours.
class SpringForces {
 public:
  SpringForces() = default;
  SpringForces(const std::vector<Spring>& springs, std::size_t particles);

  // Whether some lie in bands, and whether some do not.
  bool has_bands() const { return !pieces_.empty(); }
  bool has_unbanded() const { return !unbanded_.rest.empty(); }

  // Set rows of particles to the forces [N] on them.
  void set(const double* x, const double* v, ForceBuffers& buffers, double* forces) const;

  // Add those of springs that are in no band.
  void add_unbanded(const double* x, const double* v, double* forces) const;

  // Take columns of particles on by a step, with the forces that stand there already and those
  // of bands; then there are none.
  void step(const PlaneSteps& steps, ForceBuffers& buffers) const;

  // Make room, in which there are no forces; rows to its columns, and back.
  void allocate(ForceBuffers& buffers) const;
  void read(const double* rows, std::vector<double>& columns) const;
  void write(const std::vector<double>& columns, double* rows) const;

 private:
  struct Numbers {
    std::vector<double> rest, stiffness, damping;

    void add(double length, double stiff, double damps);
  };
  // From some particles to those an offset on, whole fours of them.
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
