// Functions on many springs, four at a time, on rows of particles (N, 4); the last number of a row
// is 0.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/wide.h"

namespace animtool {

// Doubles from one particle to the next: three components and a zero.
constexpr std::size_t PARTICLE_STRIDE = 4;

// Springs as columns; the ends of a spring are adjacent.
struct SpringColumns {
  const std::int32_t* ends;
  const double *rest_lengths, *stiffness, *damping;
};

// Springs as columns, for a step of extended position based dynamics.
struct ComplianceColumns {
  const std::int32_t* ends;
  const double *rest_lengths, *length_factors, *change_factors;
  // Inverse masses of both ends, adjacent.
  const double* inverse_masses;
};

// Forces of springs over their lengths, from squared lengths, and from dot products of relative
// velocities and offsets of the ends. Coincident ends have no direction, and no force.
template <class N>
N force_over_length(const N& rest_length, const N& stiffness, const N& damping,
                    const N& squared_length, const N& velocity_dot_offset) {
  const N inverse_square = inverse(squared_length),
          rest_ratio = rest_length * (sqrt(squared_length) * inverse_square);
  return stiffness * (1.0 - rest_ratio) + damping * (velocity_dot_offset * inverse_square);
}

// A single number, for templates that also work on several.
template <class Simd>
using Single = Wide<double, 1, Simd>;

// Loads the first three numbers of a row.
template <class Simd>
Vector3<Single<Simd>> load_vector(const double* row) {
  return {row[0], row[1], row[2]};
}
template <class Simd>
void add_to_vector(const Vector3<Single<Simd>>& change, double* row) {
  (Single<Simd>::load(row) + change.x).store(row);
  (Single<Simd>::load(row + 1) + change.y).store(row + 1);
  (Single<Simd>::load(row + 2) + change.z).store(row + 2);
}

// Adds the forces of springs to rows of particles.
template <class Simd>
void add_forces(const SpringColumns& springs, std::size_t count, const double* x, const double* v,
                double* forces) {
  using N = Four<Simd>;
  std::size_t s = 0;
  for (; s + SIMD_WIDTH <= count; s += SIMD_WIDTH) {
    const std::int32_t* ends = springs.ends + 2 * s;
    N d[SIMD_WIDTH], e[SIMD_WIDTH];
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
      const std::size_t i = PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l]);
      const std::size_t j = PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l + 1]);
      d[l] = N::load(x + j) - N::load(x + i);
      e[l] = N::load(v + j) - N::load(v + i);
    }
    double factors[SIMD_WIDTH];
    force_over_length(N::load(springs.rest_lengths + s), N::load(springs.stiffness + s),
                      N::load(springs.damping + s), dots(d, d), dots(d, e))
        .store(factors);
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
      double* f = forces + PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l]);
      double* g = forces + PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l + 1]);
      const N force = factors[l] * d[l];
      (N::load(f) + force).store(f);
      (N::load(g) - force).store(g);
    }
  }
  for (; s < count; ++s) {
    const std::size_t i = PARTICLE_STRIDE * static_cast<std::size_t>(springs.ends[2 * s]);
    const std::size_t j = PARTICLE_STRIDE * static_cast<std::size_t>(springs.ends[2 * s + 1]);
    const auto d = load_vector<Simd>(x + j) - load_vector<Simd>(x + i);
    const auto e = load_vector<Simd>(v + j) - load_vector<Simd>(v + i);
    const auto force =
        d * force_over_length<Single<Simd>>(springs.rest_lengths[s], springs.stiffness[s],
                                            springs.damping[s], dot(d, d), dot(d, e));
    add_to_vector<Simd>(force, forces + i);
    add_to_vector<Simd>(-force, forces + j);
  }
}

// Constants of particles as columns.
struct ParticleColumns {
  const double *inverse_masses, *drags;
};

// Converts rows of forces to accelerations, 0 for pinned particles. `gravity` is a row.
template <class Simd>
void accelerate_rows(const ParticleColumns& particles, std::size_t count, const double* gravity,
                     const double* v, double* rows) {
  using N = Four<Simd>;
  const N padded_gravity = N::load(gravity);
  for (std::size_t n = 0; n < count; ++n, v += PARTICLE_STRIDE, rows += PARTICLE_STRIDE) {
    const double inverse_mass = particles.inverse_masses[n];
    const N acceleration =
        N::load(rows) * inverse_mass + (padded_gravity - particles.drags[n] * N::load(v));
    (inverse_mass > 0 ? acceleration : N(0.0)).store(rows);
  }
}

// Advances by a step: velocities first, then positions with the new velocities.
template <class Simd>
void advance_rows(std::size_t count, double h, const double* accelerations, double* x, double* v) {
  using N = Four<Simd>;
  for (std::size_t k = 0; k < PARTICLE_STRIDE * count; k += PARTICLE_STRIDE) {
    const N new_velocity = N::load(v + k) + h * N::load(accelerations + k);
    new_velocity.store(v + k);
    (N::load(x + k) + h * new_velocity).store(x + k);
  }
}

// Corrects four springs without a shared end. Stores their elongations right after the correction,
// unless null.
template <class Simd>
void project_four(const ComplianceColumns& springs, std::size_t s, double* x, const double* before,
                  double* elongations) {
  using N = Four<Simd>;
  const std::int32_t* ends = springs.ends + 2 * s;
  N d[SIMD_WIDTH], e[SIMD_WIDTH];
  for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
    const std::size_t i = PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l]);
    const std::size_t j = PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l + 1]);
    d[l] = N::load(x + j) - N::load(x + i);
    e[l] = d[l] - (N::load(before + j) - N::load(before + i));
  }
  const N square = dots(d, d), inverse_square = inverse(square), length = sqrt(square);
  const N strain = zero_if_coincident(
      square, 1.0 - N::load(springs.rest_lengths + s) * (length * inverse_square));
  // The correction over the length, which moves the ends together.
  double factors[SIMD_WIDTH];
  (N::load(springs.length_factors + s) * strain +
   N::load(springs.change_factors + s) * (dots(d, e) * inverse_square))
      .store(factors);
  const double* inverse_masses = springs.inverse_masses + 2 * s;
  if (elongations) {
    double old_elongations[SIMD_WIDTH], lengths[SIMD_WIDTH];
    (strain * length).store(old_elongations);
    length.store(lengths);
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l)
      elongations[s + l] =
          old_elongations[l] -
          factors[l] * (inverse_masses[2 * l] + inverse_masses[2 * l + 1]) * lengths[l];
  }
  for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
    double* p = x + PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l]);
    double* q = x + PARTICLE_STRIDE * static_cast<std::size_t>(ends[2 * l + 1]);
    (N::load(p) + factors[l] * inverse_masses[2 * l] * d[l]).store(p);
    (N::load(q) - factors[l] * inverse_masses[2 * l + 1] * d[l]).store(q);
  }
}

// Corrects one spring.
template <class Simd>
void project_one(const ComplianceColumns& springs, std::size_t s, double* x, const double* before,
                 double* elongations) {
  using N = Single<Simd>;
  const std::size_t i = PARTICLE_STRIDE * static_cast<std::size_t>(springs.ends[2 * s]);
  const std::size_t j = PARTICLE_STRIDE * static_cast<std::size_t>(springs.ends[2 * s + 1]);
  const auto d = load_vector<Simd>(x + j) - load_vector<Simd>(x + i);
  const auto e = d - (load_vector<Simd>(before + j) - load_vector<Simd>(before + i));
  const N square = dot(d, d), inverse_square = inverse(square), length = sqrt(square);
  const N strain =
      zero_if_coincident(square, 1.0 - springs.rest_lengths[s] * (length * inverse_square));
  const N factor =
      springs.length_factors[s] * strain + springs.change_factors[s] * (dot(d, e) * inverse_square);
  const double* inverse_masses = springs.inverse_masses + 2 * s;
  if (elongations)
    ((strain - factor * (inverse_masses[0] + inverse_masses[1])) * length).store(elongations + s);
  add_to_vector<Simd>(d * (factor * inverse_masses[0]), x + i);
  add_to_vector<Simd>(-(d * (factor * inverse_masses[1])), x + j);
}

// A run of springs: groups of four without a shared end, followed by single springs.
struct SpringRunLength {
  std::size_t begin, group_count, single_count;
};

// Corrects all springs in order.
template <class Simd>
void project_all(const ComplianceColumns& springs, const SpringRunLength* runs, std::size_t count,
                 double* x, const double* before, double* elongations) {
  for (std::size_t r = 0; r < count; ++r) {
    std::size_t s = runs[r].begin;
    for (std::size_t n = 0; n < runs[r].group_count; ++n, s += SIMD_WIDTH)
      project_four<Simd>(springs, s, x, before, elongations);
    for (std::size_t n = 0; n < runs[r].single_count; ++n, ++s)
      project_one<Simd>(springs, s, x, before, elongations);
  }
}

}  // namespace animtool
