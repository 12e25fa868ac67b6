// Springs that lead from each of many particles to the one that lies as many places on: those
// of ropes, sheets and volumes, whose particles are numbered row by row.
#pragma once

#include <cstddef>

#include "springs_rows.h"

namespace animtool {

// From some particles to those an offset on, a whole number of fours; where a particle has no
// such spring, one that pulls nothing stands for it. Numbers are columns by particle.
struct SpringBand {
  std::size_t offset, first, last;
  std::size_t column;  // where the numbers of the first stand
};

struct BandNumbers {
  const SpringBand* bands;
  std::size_t count;
  const double *rest, *stiffness, *damping;
};

// Places, velocities and forces of particles as columns of x, y and z, one below the other.
struct BandPlanes {
  std::size_t height;
  double *x, *v, *f;
};

// A whole number of fours, and one more: what stands for springs may reach beyond the end.
constexpr std::size_t plane_height(std::size_t particles) {
  return (particles + WIDE - 1) / WIDE * WIDE + WIDE;
}

// Particles that are gone through with every band before the next are.
constexpr std::size_t BAND_BLOCK = 64 * WIDE;
// Offsets below this have a loop of their own for the other ends.
constexpr std::size_t SHORT_OFFSET = 4 * WIDE;

template <class W>
void rows_to_planes(const double* rows, std::size_t count, std::size_t height, double* planes) {
  typename W::Row four[WIDE];
  for (std::size_t n = 0; n < count; n += WIDE) {
    for (std::size_t l = 0; l < WIDE; ++l)
      four[l] = n + l < count ? W::load(rows + ROW * (n + l)) : W::spread(0);
    W::turn(four);
    for (std::size_t k = 0; k < 3; ++k) W::store(four[k], planes + k * height + n);
  }
}

template <class W>
void planes_to_rows(const double* planes, std::size_t count, std::size_t height, double* rows) {
  typename W::Row four[WIDE];
  for (std::size_t n = 0; n < count; n += WIDE) {
    for (std::size_t k = 0; k < 3; ++k) four[k] = W::load(planes + k * height + n);
    four[3] = W::spread(0);
    W::turn(four);
    for (std::size_t l = 0; l < WIDE && n + l < count; ++l)
      W::store(four[l], rows + ROW * (n + l));
  }
}

// Add the forces of a band's springs that begin from one particle to another.
template <class W>
void add_band(const BandNumbers& springs, const SpringBand& band, std::size_t begin,
              std::size_t end, const BandPlanes& planes) {
  using Row = typename W::Row;
  const std::size_t height = planes.height, column = band.column + (begin - band.first);
  const double *x = planes.x + begin, *v = planes.v + begin;
  const double *y = x + band.offset, *w = v + band.offset;
  const double *rest = springs.rest + column, *stiffness = springs.stiffness + column,
               *damping = springs.damping + column;
  double *f = planes.f + begin, *g = f + band.offset;
  // Reading at once what was just stored a few places further on would wait for it.
  const bool near = band.offset < SHORT_OFFSET;
  double pulls[3][BAND_BLOCK];
  const std::size_t count = end - begin;
  for (std::size_t n = 0; n < count; n += WIDE) {
    Row d[3], e[3];
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t at = k * height + n;
      d[k] = W::subtract(W::load(y + at), W::load(x + at));
      e[k] = W::subtract(W::load(w + at), W::load(v + at));
    }
    const auto along = [&](const Row* other) {
      return W::add(W::add(W::multiply(d[0], other[0]), W::multiply(d[1], other[1])),
                    W::multiply(d[2], other[2]));
    };
    const Row pull =
        pull_of<W>({W::load(rest + n), W::load(stiffness + n), W::load(damping + n)},
                   along(d), along(e));
    for (std::size_t k = 0; k < 3; ++k) {
      const Row force = W::multiply(pull, d[k]);
      W::store(W::add(W::load(f + k * height + n), force), f + k * height + n);
      if (near)
        W::store(force, pulls[k] + n);
      else
        W::store(W::subtract(W::load(g + k * height + n), force), g + k * height + n);
    }
  }
  if (!near) return;
  for (std::size_t k = 0; k < 3; ++k)
    for (std::size_t n = 0; n < count; n += WIDE)
      W::store(W::subtract(W::load(g + k * height + n), W::load(pulls[k] + n)),
               g + k * height + n);
}

// Set rows of particles to the forces of bands.
template <class W>
void set_band_pulls(const BandNumbers& springs, std::size_t particles, const double* x,
                    const double* v, const BandPlanes& planes, double* forces) {
  rows_to_planes<W>(x, particles, planes.height, planes.x);
  rows_to_planes<W>(v, particles, planes.height, planes.v);
  for (std::size_t k = 0; k < 3 * planes.height; ++k) planes.f[k] = 0;
  for (std::size_t begin = 0; begin < particles; begin += BAND_BLOCK) {
    const std::size_t end = begin + BAND_BLOCK;
    for (std::size_t b = 0; b < springs.count; ++b) {
      const SpringBand& band = springs.bands[b];
      const std::size_t from = band.first > begin ? band.first : begin;
      const std::size_t to = band.last < end ? band.last : end;
      if (from < to) add_band<W>(springs, band, from, to, planes);
    }
  }
  planes_to_rows<W>(planes.f, particles, planes.height, forces);
}

using SetBandPulls = void (*)(const BandNumbers&, std::size_t, const double*, const double*,
                              const BandPlanes&, double*);

// Where the processor has registers of four doubles, a loop that uses them; else null.
SetBandPulls set_band_pulls_in_quads();

}  // namespace animtool
