// Springs that lead from each of many particles to the one that lies as many places on: those
// of ropes, sheets and volumes, whose particles are numbered row by row.
#pragma once

#include <cstddef>
#include <utility>

#include "springs/rows.h"

namespace animtool {

// Particles that are gone through together, whole fours, and which springs begin there.
struct BandPiece {
  std::size_t begin, end;
  std::size_t first, count;  // their offsets
  std::size_t number;        // where their numbers begin
};

// Springs in bands of one offset, between their ends. Where a particle has no such spring, one
// that pulls nothing stands for it.
struct BandPieces {
  const BandPiece* pieces;
  std::size_t count;
  const std::size_t* offsets;  // of each piece, ascending
  // Of each piece, each four particles and each offset: four lengths at rest, four
  // stiffnesses and four dampings.
  const double* numbers;
};

// Places, velocities and forces of particles as columns of x, y and z, one below the other.
struct BandPlanes {
  std::size_t height;
  double *x, *v, *f;
  double* kept;  // forces of a piece's springs, (offsets, 3, KEPT)
};

// What moves particles besides springs, and for how long.
struct PlaneSteps {
  const double *inverse_masses, *drags;  // columns as high as planes
  double fall[3];
  double h;
};

// A whole number of fours, and one more: what stands for springs may reach beyond the end.
constexpr std::size_t plane_height(std::size_t particles) {
  return (particles + WIDE - 1) / WIDE * WIDE + WIDE;
}

// Most particles of a piece, so that its forces stay near.
constexpr std::size_t BAND_PIECE = 16 * WIDE;
// Offsets no farther from each other than this are taken together, so many at most.
constexpr std::size_t ALIKE = WIDE, TOGETHER = 3;
// Zeros before and after the forces that are kept, for those of other offsets.
constexpr std::size_t EDGE = ALIKE + WIDE, KEPT = BAND_PIECE + 2 * EDGE;

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

// Forces of a piece's springs: they are kept, and taken from where the springs begin.
template <class W>
void pull_begins(const BandPieces& springs, const BandPiece& piece, const BandPlanes& planes) {
  using Row = typename W::Row;
  const std::size_t height = planes.height, count = piece.count, end = piece.end;
  const std::size_t* offsets = springs.offsets + piece.first;
  const double* numbers = springs.numbers + piece.number;
  for (std::size_t n = piece.begin; n < end; n += WIDE) {
    const double *x = planes.x + n, *v = planes.v + n;
    double *f = planes.f + n, *kept = planes.kept + EDGE + (n - piece.begin);
    Row here[3], speed[3], sum[3];
    for (std::size_t k = 0; k < 3; ++k) {
      here[k] = W::load(x + k * height);
      speed[k] = W::load(v + k * height);
      sum[k] = W::load(f + k * height);
    }
    for (std::size_t b = 0; b < count; ++b, numbers += 3 * WIDE) {
      const double *y = x + offsets[b], *w = v + offsets[b];
      Row d[3], e[3];
      for (std::size_t k = 0; k < 3; ++k) {
        d[k] = W::subtract(here[k], W::load(y + k * height));
        e[k] = W::subtract(speed[k], W::load(w + k * height));
      }
      const auto along = [&](const Row* other) {
        return W::add(W::add(W::multiply(d[0], other[0]), W::multiply(d[1], other[1])),
                      W::multiply(d[2], other[2]));
      };
      const Row pull = pull_of<W>(
          {W::load(numbers), W::load(numbers + WIDE), W::load(numbers + 2 * WIDE)}, along(d),
          along(e));
      for (std::size_t k = 0; k < 3; ++k) {
        const Row force = W::multiply(pull, d[k]);
        sum[k] = W::subtract(sum[k], force);
        W::store(force, kept + (3 * b + k) * KEPT);
      }
    }
    for (std::size_t k = 0; k < 3; ++k) W::store(sum[k], f + k * height);
  }
}

// Add what was kept of some offsets to forces where their springs end.
template <class W, std::size_t... B>
void pull_alike(std::index_sequence<B...>, const std::size_t* offsets, const double* kept,
                std::size_t begin, std::size_t end, double* forces) {
  const std::size_t last = offsets[sizeof...(B) - 1];
  const std::size_t back[] = {begin + offsets[B]...};
  for (std::size_t n = (begin + offsets[0]) / WIDE * WIDE; n < end + last; n += WIDE) {
    auto sum = W::load(forces + n);
    ((sum = W::add(sum, W::load(kept + 3 * B * KEPT + (EDGE + n - back[B])))), ...);
    W::store(sum, forces + n);
  }
}

// Forces of a piece's springs where these end. They are added when all are known: reading at
// once what was just stored a few places further on would wait for it.
template <class W>
void pull_ends(const BandPieces& springs, const BandPiece& piece, const BandPlanes& planes) {
  for (std::size_t row = 0; row < 3 * piece.count; ++row)
    for (std::size_t n = 0; n < EDGE; n += WIDE)
      W::store(W::spread(0), planes.kept + row * KEPT + EDGE + (piece.end - piece.begin) + n);
  const std::size_t* offsets = springs.offsets + piece.first;
  for (std::size_t b = 0, count; b < piece.count; b += count) {
    for (count = 1; count < TOGETHER && b + count < piece.count; ++count)
      if (offsets[b + count] > offsets[b] + ALIKE) break;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto add = [&](auto alike) {
        pull_alike<W>(alike, offsets + b, planes.kept + (3 * b + k) * KEPT, piece.begin,
                      piece.end, planes.f + k * planes.height);
      };
      if (count == 1) add(std::make_index_sequence<1>());
      if (count == 2) add(std::make_index_sequence<2>());
      if (count == TOGETHER) add(std::make_index_sequence<TOGETHER>());
    }
  }
}

// Go on with a piece's particles by the forces on them, which then are none: velocities first,
// and places with the new ones. Those that are held stay.
template <class W>
void advance_piece(const BandPiece& piece, const PlaneSteps& steps, const BandPlanes& planes) {
  const auto zero = W::spread(0), time = W::spread(steps.h);
  for (std::size_t n = piece.begin; n < piece.end; n += WIDE) {
    const auto inverse = W::load(steps.inverse_masses + n), drag = W::load(steps.drags + n);
    const auto free = W::below(zero, inverse);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t at = k * planes.height + n;
      const auto x = W::load(planes.x + at), v = W::load(planes.v + at);
      const auto slowed = W::subtract(W::spread(steps.fall[k]), W::multiply(drag, v));
      const auto rate = W::add(W::multiply(W::load(planes.f + at), inverse), slowed);
      const auto speed = W::add(v, W::multiply(time, rate));
      W::store(W::chosen(free, speed, v), planes.v + at);
      W::store(W::chosen(free, W::add(x, W::multiply(time, speed)), x), planes.x + at);
      W::store(zero, planes.f + at);
    }
  }
}

// Add the forces of springs to planes of forces.
template <class W>
void pull_planes(const BandPieces& springs, const BandPlanes& planes) {
  for (std::size_t p = 0; p < springs.count; ++p) {
    pull_begins<W>(springs, springs.pieces[p], planes);
    pull_ends<W>(springs, springs.pieces[p], planes);
  }
}

// One step of particles that springs and the planes of forces pull. Pieces come in the order of
// their particles: none reads those of an earlier one, which may go on.
template <class W>
void step_planes(const BandPieces& springs, const PlaneSteps& steps, const BandPlanes& planes) {
  for (std::size_t p = 0; p < springs.count; ++p) {
    pull_begins<W>(springs, springs.pieces[p], planes);
    pull_ends<W>(springs, springs.pieces[p], planes);
    advance_piece<W>(springs.pieces[p], steps, planes);
  }
}

// Loops over planes, and between these and rows.
struct PlaneLoops {
  void (*read)(const double* rows, std::size_t count, std::size_t height, double* planes);
  void (*write)(const double* planes, std::size_t count, std::size_t height, double* rows);
  void (*pull)(const BandPieces&, const BandPlanes&);
  void (*step)(const BandPieces&, const PlaneSteps&, const BandPlanes&);
};

template <class W>
constexpr PlaneLoops plane_loops() {
  return {rows_to_planes<W>, planes_to_rows<W>, pull_planes<W>, step_planes<W>};
}

// Those for registers of four doubles, where the processor has them.
PlaneLoops plane_loops_here();

}  // namespace animtool
