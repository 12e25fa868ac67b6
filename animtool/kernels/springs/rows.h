// Springs four at a time: rows of particles (N, 4), of which the last number is 0.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/rows.h"

namespace animtool {

// Numbers to a particle.
constexpr std::size_t ROW = 4;

// What of springs the loops read, a column each; ends two by two.
struct SpringColumns {
  const std::int32_t* ends;
  const double *rest, *stiffness, *damping;
};

// What of springs a step of extended position based dynamics reads.
struct GiveColumns {
  const std::int32_t* ends;
  const double *rest, *length, *change;
  // Weights of both ends, two by two.
  const double* weights;
};

// Of four springs.
template <class Row>
struct FourSprings {
  Row rest, stiffness, damping;
};

// Forces of springs over their lengths, from the squares of these and from how their ends
// move apart times these. Ends at one place have no direction, and no force.
template <class W>
typename W::Row pull_of(const FourSprings<typename W::Row>& springs,
                        const typename W::Row& square, const typename W::Row& closing) {
  const auto inverse = W::inverse(square);
  const auto length = W::multiply(springs.rest, W::multiply(W::root(square), inverse));
  return W::add(W::multiply(springs.stiffness, W::subtract(W::spread(1), length)),
                W::multiply(springs.damping, W::multiply(closing, inverse)));
}

// Add the forces of springs to rows of particles.
template <class W>
void add_pulls(const SpringColumns& springs, std::size_t count, const double* x,
               const double* v, double* forces) {
  using Row = typename W::Row;
  std::size_t s = 0;
  for (; s + WIDE <= count; s += WIDE) {
    const std::int32_t* ends = springs.ends + 2 * s;
    Row d[WIDE], e[WIDE];
    for (std::size_t l = 0; l < WIDE; ++l) {
      const std::size_t i = ROW * static_cast<std::size_t>(ends[2 * l]);
      const std::size_t j = ROW * static_cast<std::size_t>(ends[2 * l + 1]);
      d[l] = W::subtract(W::load(x + j), W::load(x + i));
      e[l] = W::subtract(W::load(v + j), W::load(v + i));
    }
    const Row pull =
        pull_of<W>({W::load(springs.rest + s), W::load(springs.stiffness + s),
                    W::load(springs.damping + s)},
                   W::dots(d, d), W::dots(d, e));
    double pulls[WIDE];
    W::store(pull, pulls);
    for (std::size_t l = 0; l < WIDE; ++l) {
      double* f = forces + ROW * static_cast<std::size_t>(ends[2 * l]);
      double* g = forces + ROW * static_cast<std::size_t>(ends[2 * l + 1]);
      const Row force = W::multiply(W::spread(pulls[l]), d[l]);
      W::store(W::add(W::load(f), force), f);
      W::store(W::subtract(W::load(g), force), g);
    }
  }
  for (; s < count; ++s) {
    const std::size_t i = ROW * static_cast<std::size_t>(springs.ends[2 * s]);
    const std::size_t j = ROW * static_cast<std::size_t>(springs.ends[2 * s + 1]);
    double d[3], e[3];
    for (std::size_t k = 0; k < 3; ++k) {
      d[k] = x[j + k] - x[i + k];
      e[k] = v[j + k] - v[i + k];
    }
    const double square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    const double closing = d[0] * e[0] + d[1] * e[1] + d[2] * e[2];
    const double inverse = square > ONE_PLACE ? 1 / square : 0;
    const double length = springs.rest[s] * (std::sqrt(square) * inverse);
    const double pull =
        springs.stiffness[s] * (1 - length) + springs.damping[s] * (closing * inverse);
    for (std::size_t k = 0; k < 3; ++k) {
      const double force = pull * d[k];
      forces[i + k] += force;
      forces[j + k] -= force;
    }
  }
}

// Of particles, by number.
struct ParticleColumns {
  const double *inverse_masses, *drags;
};

// Turn rows of forces into accelerations: those of held particles are 0. What falls freely is
// a row.
template <class W>
void accelerate_rows(const ParticleColumns& particles, std::size_t count, const double* fall,
                     const double* v, double* rows) {
  const auto falling = W::load(fall);
  for (std::size_t n = 0; n < count; ++n, v += ROW, rows += ROW) {
    const double inverse = particles.inverse_masses[n];
    const auto slowed = W::multiply(W::spread(particles.drags[n]), W::load(v));
    const auto pulled = W::multiply(W::load(rows), W::spread(inverse));
    const auto whole = W::add(pulled, W::subtract(falling, slowed));
    W::store(inverse > 0 ? whole : W::spread(0), rows);
  }
}

// Go on for a time: velocities first, and places with the new ones.
template <class W>
void advance_rows(std::size_t count, double h, const double* rates, double* x, double* v) {
  const auto time = W::spread(h);
  for (std::size_t k = 0; k < ROW * count; k += ROW) {
    const auto speed = W::add(W::load(v + k), W::multiply(time, W::load(rates + k)));
    W::store(speed, v + k);
    W::store(W::add(W::load(x + k), W::multiply(time, speed)), x + k);
  }
}

// Move the ends of four springs that share none together, and keep by how much these are longer
// than at rest right after.
template <class W>
void project_four(const GiveColumns& springs, std::size_t s, double* x, const double* before,
                  double* kept) {
  using Row = typename W::Row;
  const std::int32_t* ends = springs.ends + 2 * s;
  Row d[WIDE], e[WIDE];
  for (std::size_t l = 0; l < WIDE; ++l) {
    const std::size_t i = ROW * static_cast<std::size_t>(ends[2 * l]);
    const std::size_t j = ROW * static_cast<std::size_t>(ends[2 * l + 1]);
    d[l] = W::subtract(W::load(x + j), W::load(x + i));
    e[l] = W::subtract(d[l], W::subtract(W::load(before + j), W::load(before + i)));
  }
  const Row square = W::dots(d, d), went = W::dots(d, e);
  const Row inverse = W::inverse(square), root = W::root(square);
  const Row beyond = W::subtract(
      W::spread(1), W::multiply(W::load(springs.rest + s), W::multiply(root, inverse)));
  // The pull over the length, with which the ends come together.
  const Row pull = W::add(
      W::multiply(W::load(springs.length + s), W::where_apart(square, beyond)),
      W::multiply(W::load(springs.change + s), W::multiply(went, inverse)));
  double pulls[WIDE];
  W::store(pull, pulls);
  const double* weights = springs.weights + 2 * s;
  if (kept) {
    double longer[WIDE], lengths[WIDE];
    W::store(W::multiply(W::where_apart(square, beyond), root), longer);
    W::store(root, lengths);
    for (std::size_t l = 0; l < WIDE; ++l)
      kept[s + l] =
          longer[l] - pulls[l] * (weights[2 * l] + weights[2 * l + 1]) * lengths[l];
  }
  for (std::size_t l = 0; l < WIDE; ++l) {
    double* p = x + ROW * static_cast<std::size_t>(ends[2 * l]);
    double* q = x + ROW * static_cast<std::size_t>(ends[2 * l + 1]);
    W::store(W::add(W::load(p), W::multiply(W::spread(pulls[l] * weights[2 * l]), d[l])), p);
    W::store(W::subtract(W::load(q),
                         W::multiply(W::spread(pulls[l] * weights[2 * l + 1]), d[l])),
             q);
  }
}

template <class W>
void project_one(const GiveColumns& springs, std::size_t s, double* x,
                        const double* before, double* kept) {
  const std::size_t i = ROW * static_cast<std::size_t>(springs.ends[2 * s]);
  const std::size_t j = ROW * static_cast<std::size_t>(springs.ends[2 * s + 1]);
  double d[3], e[3];
  for (std::size_t k = 0; k < 3; ++k) {
    d[k] = x[j + k] - x[i + k];
    e[k] = d[k] - (before[j + k] - before[i + k]);
  }
  const double square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
  const double went = d[0] * e[0] + d[1] * e[1] + d[2] * e[2];
  const double inverse = square > ONE_PLACE ? 1 / square : 0, root = std::sqrt(square);
  const double beyond = square > ONE_PLACE ? 1 - springs.rest[s] * (root * inverse) : 0;
  const double pull = springs.length[s] * beyond + springs.change[s] * (went * inverse);
  const double both = springs.weights[2 * s] + springs.weights[2 * s + 1];
  if (kept) kept[s] = (beyond - pull * both) * root;
  for (std::size_t k = 0; k < 3; ++k) {
    x[i + k] += pull * springs.weights[2 * s] * d[k];
    x[j + k] -= pull * springs.weights[2 * s + 1] * d[k];
  }
}

// Runs of springs, of which each four share no end or are done one by one.
struct SpringRunLength {
  std::size_t begin, fours, ones;
};

template <class W>
void project_all(const GiveColumns& springs, const SpringRunLength* runs, std::size_t count,
                 double* x, const double* before, double* kept) {
  for (std::size_t r = 0; r < count; ++r) {
    std::size_t s = runs[r].begin;
    for (std::size_t n = 0; n < runs[r].fours; ++n, s += WIDE)
      project_four<W>(springs, s, x, before, kept);
    for (std::size_t n = 0; n < runs[r].ones; ++n, ++s)
      project_one<W>(springs, s, x, before, kept);
  }
}

using AddPulls = void (*)(const SpringColumns&, std::size_t, const double*, const double*,
                          double*);
using AccelerateRows = void (*)(const ParticleColumns&, std::size_t, const double*,
                                const double*, double*);
using AdvanceRows = void (*)(std::size_t, double, const double*, double*, double*);
using ProjectAll = void (*)(const GiveColumns&, const SpringRunLength*, std::size_t, double*,
                            const double*, double*);

// Where the processor has registers of four doubles, loops that use them; else null.
AddPulls add_pulls_in_quads();
AccelerateRows accelerate_rows_in_quads();
AdvanceRows advance_rows_in_quads();
ProjectAll project_all_in_quads();

}  // namespace animtool
