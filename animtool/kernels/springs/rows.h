// Springs four at a time: rows of particles (N, 4), of which the last number is 0.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/wide.h"

namespace animtool {

// Numbers of a particle.
constexpr std::size_t ROW = 4;

// Springs as columns; both ends are adjacent.
struct SpringColumns {
  const std::int32_t* ends;
  const double *rest, *stiffness, *damping;
};

// Springs in a step of extended position based dynamics.
struct ComplianceColumns {
  const std::int32_t* ends;
  const double *rest, *length, *change;
  // Weights of both ends, adjacent.
  const double* weights;
};

// Forces of springs over their lengths, from squared lengths, and from relative velocities of the
// ends dotted with the offsets. Coincident ends have no direction, and no force.
template <class N>
N force_over_length(const N& rest, const N& stiffness, const N& damping, const N& square,
                    const N& closing) {
  const N over = inverse(square), length = rest * (sqrt(square) * over);
  return stiffness * (1.0 - length) + damping * (closing * over);
}

// A single particle or spring, for code that works on several.
template <class On>
using One = Wide<double, 1, On>;

template <class On>
Vector3<One<On>> row_at(const double* from) {
  return {from[0], from[1], from[2]};
}
template <class On>
void add_to_row(const Vector3<One<On>>& shift, double* row) {
  (One<On>::of(row) + shift.x).store(row);
  (One<On>::of(row + 1) + shift.y).store(row + 1);
  (One<On>::of(row + 2) + shift.z).store(row + 2);
}

// Adds the forces of springs to rows of particles.
template <class On>
void add_forces(const SpringColumns& springs, std::size_t count, const double* x, const double* v,
                double* forces) {
  using N = Four<On>;
  std::size_t s = 0;
  for (; s + WIDE <= count; s += WIDE) {
    const std::int32_t* ends = springs.ends + 2 * s;
    N d[WIDE], e[WIDE];
    for (std::size_t l = 0; l < WIDE; ++l) {
      const std::size_t i = ROW * static_cast<std::size_t>(ends[2 * l]);
      const std::size_t j = ROW * static_cast<std::size_t>(ends[2 * l + 1]);
      d[l] = N::of(x + j) - N::of(x + i);
      e[l] = N::of(v + j) - N::of(v + i);
    }
    double pulls[WIDE];
    force_over_length(N::of(springs.rest + s), N::of(springs.stiffness + s),
                      N::of(springs.damping + s), dots(d, d), dots(d, e))
        .store(pulls);
    for (std::size_t l = 0; l < WIDE; ++l) {
      double* f = forces + ROW * static_cast<std::size_t>(ends[2 * l]);
      double* g = forces + ROW * static_cast<std::size_t>(ends[2 * l + 1]);
      const N force = pulls[l] * d[l];
      (N::of(f) + force).store(f);
      (N::of(g) - force).store(g);
    }
  }
  for (; s < count; ++s) {
    const std::size_t i = ROW * static_cast<std::size_t>(springs.ends[2 * s]);
    const std::size_t j = ROW * static_cast<std::size_t>(springs.ends[2 * s + 1]);
    const auto d = row_at<On>(x + j) - row_at<On>(x + i);
    const auto e = row_at<On>(v + j) - row_at<On>(v + i);
    const auto force = d * force_over_length<One<On>>(springs.rest[s], springs.stiffness[s],
                                                      springs.damping[s], dot(d, d), dot(d, e));
    add_to_row<On>(force, forces + i);
    add_to_row<On>(-force, forces + j);
  }
}

// Particles as columns.
struct ParticleColumns {
  const double *inverse_masses, *drags;
};

// Converts rows of forces to accelerations, 0 for pinned particles. `fall` is the gravity, as a
// row.
template <class On>
void accelerate_rows(const ParticleColumns& particles, std::size_t count, const double* fall,
                     const double* v, double* rows) {
  using N = Four<On>;
  const N falling = N::of(fall);
  for (std::size_t n = 0; n < count; ++n, v += ROW, rows += ROW) {
    const double inverse = particles.inverse_masses[n];
    const N full = N::of(rows) * inverse + (falling - particles.drags[n] * N::of(v));
    (inverse > 0 ? full : N(0.0)).store(rows);
  }
}

// Takes a step: velocities first, then positions with the new velocities.
template <class On>
void advance_rows(std::size_t count, double h, const double* rates, double* x, double* v) {
  using N = Four<On>;
  for (std::size_t k = 0; k < ROW * count; k += ROW) {
    const N speed = N::of(v + k) + h * N::of(rates + k);
    speed.store(v + k);
    (N::of(x + k) + h * speed).store(x + k);
  }
}

// Corrects four springs without a shared end, and stores how much longer than at rest they are
// right after.
template <class On>
void project_four(const ComplianceColumns& springs, std::size_t s, double* x, const double* before,
                  double* excess) {
  using N = Four<On>;
  const std::int32_t* ends = springs.ends + 2 * s;
  N d[WIDE], e[WIDE];
  for (std::size_t l = 0; l < WIDE; ++l) {
    const std::size_t i = ROW * static_cast<std::size_t>(ends[2 * l]);
    const std::size_t j = ROW * static_cast<std::size_t>(ends[2 * l + 1]);
    d[l] = N::of(x + j) - N::of(x + i);
    e[l] = d[l] - (N::of(before + j) - N::of(before + i));
  }
  const N square = dots(d, d), over = inverse(square), size = sqrt(square);
  const N beyond = if_distinct(square, 1.0 - N::of(springs.rest + s) * (size * over));
  // The correction over the length, which moves the ends together.
  double pulls[WIDE];
  (N::of(springs.length + s) * beyond + N::of(springs.change + s) * (dots(d, e) * over))
      .store(pulls);
  const double* weights = springs.weights + 2 * s;
  if (excess) {
    double longer[WIDE], lengths[WIDE];
    (beyond * size).store(longer);
    size.store(lengths);
    for (std::size_t l = 0; l < WIDE; ++l)
      excess[s + l] = longer[l] - pulls[l] * (weights[2 * l] + weights[2 * l + 1]) * lengths[l];
  }
  for (std::size_t l = 0; l < WIDE; ++l) {
    double* p = x + ROW * static_cast<std::size_t>(ends[2 * l]);
    double* q = x + ROW * static_cast<std::size_t>(ends[2 * l + 1]);
    (N::of(p) + pulls[l] * weights[2 * l] * d[l]).store(p);
    (N::of(q) - pulls[l] * weights[2 * l + 1] * d[l]).store(q);
  }
}

template <class On>
void project_one(const ComplianceColumns& springs, std::size_t s, double* x, const double* before,
                 double* excess) {
  using N = One<On>;
  const std::size_t i = ROW * static_cast<std::size_t>(springs.ends[2 * s]);
  const std::size_t j = ROW * static_cast<std::size_t>(springs.ends[2 * s + 1]);
  const auto d = row_at<On>(x + j) - row_at<On>(x + i);
  const auto e = d - (row_at<On>(before + j) - row_at<On>(before + i));
  const N square = dot(d, d), over = inverse(square), size = sqrt(square);
  const N beyond = if_distinct(square, 1.0 - springs.rest[s] * (size * over));
  const N pull = springs.length[s] * beyond + springs.change[s] * (dot(d, e) * over);
  const double* weights = springs.weights + 2 * s;
  if (excess) ((beyond - pull * (weights[0] + weights[1])) * size).store(excess + s);
  add_to_row<On>(d * (pull * weights[0]), x + i);
  add_to_row<On>(-(d * (pull * weights[1])), x + j);
}

// A run of springs: groups of four without a shared end, then single ones.
struct SpringRunLength {
  std::size_t begin, fours, ones;
};

template <class On>
void project_all(const ComplianceColumns& springs, const SpringRunLength* runs, std::size_t count,
                 double* x, const double* before, double* excess) {
  for (std::size_t r = 0; r < count; ++r) {
    std::size_t s = runs[r].begin;
    for (std::size_t n = 0; n < runs[r].fours; ++n, s += WIDE)
      project_four<On>(springs, s, x, before, excess);
    for (std::size_t n = 0; n < runs[r].ones; ++n, ++s)
      project_one<On>(springs, s, x, before, excess);
  }
}

}  // namespace animtool
