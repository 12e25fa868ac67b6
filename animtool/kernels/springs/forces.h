// The forces of springs on particles.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "springs/bands.h"
#include "springs/rows.h"

namespace animtool {

// A spring between particles i and j.
struct Spring {
  std::int32_t i, j;
  double rest_length, stiffness, damping, tear_length;
};

// Particles in columns: positions, velocities, forces; and the forces of a chunk's springs.
struct ForceBuffers {
  std::vector<double> x, v, f, spring_forces;
};

// Computes the forces of springs: in bands of equal index offset where there are many, the others
// four at a time.
class SpringForces {
 public:
  SpringForces() = default;
  SpringForces(const std::vector<Spring>& springs, std::size_t particles);

  // Whether there are bands, and springs outside of bands.
  bool has_bands() const { return !chunks_.empty(); }
  bool has_unbanded() const { return !unbanded_coefficients_.rest_lengths.empty(); }

  // Computes the forces on particles [N], in rows.
  void compute(const double* x, const double* v, ForceBuffers& buffers, double* forces) const;

  // Adds the forces of springs outside bands.
  void add_unbanded(const double* x, const double* v, double* forces) const;

  // Advances particles in columns by a step, under the forces in the buffers and of bands; clears
  // the forces.
  void step(const PlaneSteps& steps, ForceBuffers& buffers) const;

  // Allocates buffers with zero forces. `read` converts rows to columns, `write` converts back.
  void allocate(ForceBuffers& buffers) const;
  void read(const double* rows, std::vector<double>& columns) const;
  void write(const std::vector<double>& columns, double* rows) const;

 private:
  struct Coefficients {
    std::vector<double> rest_lengths, stiffness, damping;

    void add(double rest_length, double spring_stiffness, double spring_damping);
  };
  // Springs from particles first to last, in multiples of four, to the particles an index offset
  // later.
  struct Band {
    std::size_t offset, first, last;
    Coefficients coefficients;
  };

  static Band build_band(const std::vector<Spring>& springs,
                         const std::vector<std::size_t>& band_springs);
  std::vector<Band> build_bands(const std::vector<Spring>& springs,
                                std::vector<std::size_t>& banded_springs) const;
  void build_chunks(std::vector<Band> bands);
  void build_chunk(std::size_t begin, std::size_t end, std::vector<const Band*> bands);
  BandChunks chunks() const;
  BandPlanes planes(ForceBuffers& buffers) const;

  std::size_t particles_ = 0;
  std::vector<BandChunk> chunks_;
  std::size_t max_offset_count_ = 0;  // largest number of a chunk
  std::vector<std::size_t> offsets_;
  std::vector<double> coefficients_;
  Coefficients unbanded_coefficients_;
  std::vector<std::int32_t> unbanded_ends_;
};

}  // namespace animtool
