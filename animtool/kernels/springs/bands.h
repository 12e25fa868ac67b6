// Springs with a constant index offset between their ends, as in ropes, sheets and volumes
// whose particles are numbered row by row.
#pragma once

#include <cstddef>
#include <utility>

#include "springs/rows.h"

namespace animtool {

// A range of particles that are processed together, in multiples of four, and the springs that
// start there.
struct BandChunk {
  std::size_t begin, end;
  std::size_t first_offset, offset_count;  // range in the offsets of all chunks
  std::size_t first_coefficient;           // index of its first coefficient
};

// Springs in bands of equal index offset. Particles without such a spring get one without force.
struct BandChunks {
  const BandChunk* chunks;
  std::size_t count;
  const std::size_t* offsets;  // of each chunk, ascending
  // For each chunk, group of four particles and offset: four rest lengths, four stiffnesses and
  // four dampings.
  const double* coefficients;
};

// Positions, velocities and forces of particles as planes: columns of x, of y and of z, one after
// the other.
struct BandPlanes {
  std::size_t height;
  double *x, *v, *f;
  double* spring_forces;  // of a chunk, (offsets, 3, FORCE_COLUMN)
};

// Forces other than springs, and the length of a step.
struct PlaneSteps {
  const double *inverse_masses, *drags;  // columns as high as planes
  double gravity[3];
  double h;
};

// Rounds up to a multiple of four, plus four: padding springs may end beyond the last particle.
constexpr std::size_t plane_height(std::size_t particles) {
  return (particles + SIMD_WIDTH - 1) / SIMD_WIDTH * SIMD_WIDTH + SIMD_WIDTH;
}

// Largest number of particles of a chunk, so that its forces stay in the cache.
constexpr std::size_t MAX_CHUNK_SIZE = 16 * SIMD_WIDTH;
// Offsets are processed as a group if they differ by at most MAX_OFFSET_SPREAD; largest group.
constexpr std::size_t MAX_OFFSET_SPREAD = SIMD_WIDTH, MAX_GROUP_SIZE = 3;
// Zero padding before and after the spring forces, for accesses with other offsets.
constexpr std::size_t FORCE_PADDING = MAX_OFFSET_SPREAD + SIMD_WIDTH,
                      FORCE_COLUMN = MAX_CHUNK_SIZE + 2 * FORCE_PADDING;

// Converts rows of particles to planes.
template <class Simd>
void rows_to_planes(const double* rows, std::size_t count, std::size_t height, double* planes) {
  Four<Simd> vectors[SIMD_WIDTH];
  for (std::size_t n = 0; n < count; n += SIMD_WIDTH) {
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l)
      vectors[l] = n + l < count ? Four<Simd>::load(rows + PARTICLE_STRIDE * (n + l)) : 0.0;
    transpose(vectors, vectors);
    for (std::size_t k = 0; k < 3; ++k) vectors[k].store(planes + k * height + n);
  }
}

// Converts planes to rows of particles.
template <class Simd>
void planes_to_rows(const double* planes, std::size_t count, std::size_t height, double* rows) {
  Four<Simd> vectors[SIMD_WIDTH];
  for (std::size_t n = 0; n < count; n += SIMD_WIDTH) {
    for (std::size_t k = 0; k < 3; ++k) vectors[k] = Four<Simd>::load(planes + k * height + n);
    vectors[3] = 0.0;
    transpose(vectors, vectors);
    for (std::size_t l = 0; l < SIMD_WIDTH && n + l < count; ++l)
      vectors[l].store(rows + PARTICLE_STRIDE * (n + l));
  }
}

// Computes the forces of a chunk's springs: stores them, and adds them at the start of each spring.
template <class Simd>
void add_start_forces(const BandChunks& springs, const BandChunk& chunk, const BandPlanes& planes) {
  using N = Four<Simd>;
  const std::size_t height = planes.height, count = chunk.offset_count, end = chunk.end;
  const std::size_t* offsets = springs.offsets + chunk.first_offset;
  const double* coefficients = springs.coefficients + chunk.first_coefficient;
  const auto load_vectors = [height](const double* plane) {
    return Vector3<N>{N::load(plane), N::load(plane + height), N::load(plane + 2 * height)};
  };
  for (std::size_t n = chunk.begin; n < end; n += SIMD_WIDTH) {
    const double *x = planes.x + n, *v = planes.v + n;
    double *f = planes.f + n,
           *spring_forces = planes.spring_forces + FORCE_PADDING + (n - chunk.begin);
    const Vector3<N> position = load_vectors(x), velocity = load_vectors(v);
    Vector3<N> sum = load_vectors(f);
    for (std::size_t b = 0; b < count;
         ++b, coefficients += 3 * SIMD_WIDTH, spring_forces += 3 * FORCE_COLUMN) {
      const Vector3<N> d = position - load_vectors(x + offsets[b]),
                       relative_velocity = velocity - load_vectors(v + offsets[b]);
      const Vector3<N> force =
          d * force_over_length(N::load(coefficients), N::load(coefficients + SIMD_WIDTH),
                                N::load(coefficients + 2 * SIMD_WIDTH), dot(d, d),
                                dot(d, relative_velocity));
      sum -= force;
      force.x.store(spring_forces), force.y.store(spring_forces + FORCE_COLUMN),
          force.z.store(spring_forces + 2 * FORCE_COLUMN);
    }
    sum.x.store(f), sum.y.store(f + height), sum.z.store(f + 2 * height);
  }
}

// Adds the stored forces of a group of offsets at the end of each spring.
template <class Simd, std::size_t... B>
void add_grouped_forces(std::index_sequence<B...>, const std::size_t* offsets,
                        const double* spring_forces, std::size_t begin, std::size_t end,
                        double* forces) {
  const std::size_t last_offset = offsets[sizeof...(B) - 1];
  const std::size_t starts[] = {begin + offsets[B]...};
  for (std::size_t n = (begin + offsets[0]) / SIMD_WIDTH * SIMD_WIDTH; n < end + last_offset;
       n += SIMD_WIDTH) {
    Four<Simd> sum = Four<Simd>::load(forces + n);
    ((sum +=
      Four<Simd>::load(spring_forces + 3 * B * FORCE_COLUMN + (FORCE_PADDING + n - starts[B]))),
     ...);
    sum.store(forces + n);
  }
}

// Adds the forces of a chunk's springs at their ends, after all are computed: loading a value right
// after it was stored at an overlapping address would stall.
template <class Simd>
void add_end_forces(const BandChunks& springs, const BandChunk& chunk, const BandPlanes& planes) {
  for (std::size_t row = 0; row < 3 * chunk.offset_count; ++row)
    for (std::size_t n = 0; n < FORCE_PADDING; n += SIMD_WIDTH)
      Four<Simd>(0.0).store(planes.spring_forces + row * FORCE_COLUMN + FORCE_PADDING +
                            (chunk.end - chunk.begin) + n);
  const std::size_t* offsets = springs.offsets + chunk.first_offset;
  for (std::size_t b = 0, count; b < chunk.offset_count; b += count) {
    for (count = 1; count < MAX_GROUP_SIZE && b + count < chunk.offset_count; ++count)
      if (offsets[b + count] > offsets[b] + MAX_OFFSET_SPREAD) break;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto add_group = [&](auto indices) {
        add_grouped_forces<Simd>(indices, offsets + b,
                                 planes.spring_forces + (3 * b + k) * FORCE_COLUMN, chunk.begin,
                                 chunk.end, planes.f + k * planes.height);
      };
      if (count == 1) add_group(std::make_index_sequence<1>());
      if (count == 2) add_group(std::make_index_sequence<2>());
      if (count == MAX_GROUP_SIZE) add_group(std::make_index_sequence<MAX_GROUP_SIZE>());
    }
  }
}

// Advances the particles of a chunk by a step, and clears the forces on them: velocities first,
// then positions with the new velocities. Pinned particles stay.
template <class Simd>
void advance_chunk(const BandChunk& chunk, const PlaneSteps& steps, const BandPlanes& planes) {
  using N = Four<Simd>;
  const N zero = 0.0;
  for (std::size_t n = chunk.begin; n < chunk.end; n += SIMD_WIDTH) {
    const N inverse = N::load(steps.inverse_masses + n), drag = N::load(steps.drags + n);
    const N is_free = less(zero, inverse);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t index = k * planes.height + n;
      const N x = N::load(planes.x + index), v = N::load(planes.v + index);
      const N acceleration = N::load(planes.f + index) * inverse + (steps.gravity[k] - drag * v);
      const N new_velocity = v + steps.h * acceleration;
      select(is_free, new_velocity, v).store(planes.v + index);
      select(is_free, x + steps.h * new_velocity, x).store(planes.x + index);
      zero.store(planes.f + index);
    }
  }
}

// Adds the forces of springs to planes.
template <class Simd>
void add_plane_forces(const BandChunks& springs, const BandPlanes& planes) {
  for (std::size_t p = 0; p < springs.count; ++p) {
    add_start_forces<Simd>(springs, springs.chunks[p], planes);
    add_end_forces<Simd>(springs, springs.chunks[p], planes);
  }
}

// Advances particles by one step under the forces of springs and of the planes. Chunks are in the
// order of their particles, and none reads particles of an earlier one, which may already be
// advanced.
template <class Simd>
void step_planes(const BandChunks& springs, const PlaneSteps& steps, const BandPlanes& planes) {
  for (std::size_t p = 0; p < springs.count; ++p) {
    add_start_forces<Simd>(springs, springs.chunks[p], planes);
    add_end_forces<Simd>(springs, springs.chunks[p], planes);
    advance_chunk<Simd>(springs.chunks[p], steps, planes);
  }
}

}  // namespace animtool
