// Springs with a constant index offset between their ends, as in ropes, sheets and volumes
// whose particles are numbered row by row.
#pragma once

#include <cstddef>
#include <utility>

#include "springs/rows.h"

namespace animtool {

// Particles processed together, in multiples of four, and the springs that start there.
struct BandPiece {
  std::size_t begin, end;
  std::size_t first, count;  // range of its offsets
  std::size_t number;        // index of its first coefficient
};

// Springs in bands with the same index offset. Particles without such a spring get one without
// force.
struct BandPieces {
  const BandPiece* pieces;
  std::size_t count;
  const std::size_t* offsets;  // of each piece, ascending
  // For each piece, group of four particles and offset: four rest lengths, four
  // stiffnesses and four dampings.
  const double* numbers;
};

// Positions, velocities and forces of particles as columns of x, y and z, one below the other.
struct BandPlanes {
  std::size_t height;
  double *x, *v, *f;
  double* stored;  // forces of a piece's springs, (offsets, 3, KEPT)
};

// Forces other than springs, and the step length.
struct PlaneSteps {
  const double *inverse_masses, *drags;  // columns as high as planes
  double fall[3];
  double h;
};

// Rounded up to a multiple of four, plus four: padding springs may reach beyond the end.
constexpr std::size_t plane_height(std::size_t particles) {
  return (particles + WIDE - 1) / WIDE * WIDE + WIDE;
}

// Largest number of particles of a piece, so that its forces stay in the cache.
constexpr std::size_t BAND_PIECE = 16 * WIDE;
// Offsets that differ by at most this are processed together, at most this many.
constexpr std::size_t GROUPED = WIDE, TOGETHER = 3;
// Zero padding before and after the stored forces, for accesses with other offsets.
constexpr std::size_t EDGE = GROUPED + WIDE, STORED = BAND_PIECE + 2 * EDGE;

template <class On>
void rows_to_planes(const double* rows, std::size_t count, std::size_t height, double* planes) {
  Four<On> four[WIDE];
  for (std::size_t n = 0; n < count; n += WIDE) {
    for (std::size_t l = 0; l < WIDE; ++l)
      four[l] = n + l < count ? Four<On>::of(rows + ROW * (n + l)) : 0.0;
    transpose(four, four);
    for (std::size_t k = 0; k < 3; ++k) four[k].store(planes + k * height + n);
  }
}

template <class On>
void planes_to_rows(const double* planes, std::size_t count, std::size_t height, double* rows) {
  Four<On> four[WIDE];
  for (std::size_t n = 0; n < count; n += WIDE) {
    for (std::size_t k = 0; k < 3; ++k) four[k] = Four<On>::of(planes + k * height + n);
    four[3] = 0.0;
    transpose(four, four);
    for (std::size_t l = 0; l < WIDE && n + l < count; ++l) four[l].store(rows + ROW * (n + l));
  }
}

// Computes the forces of a piece's springs: stores them, and subtracts them at the first ends.
template <class On>
void pull_begins(const BandPieces& springs, const BandPiece& piece, const BandPlanes& planes) {
  using N = Four<On>;
  const std::size_t height = planes.height, count = piece.count, end = piece.end;
  const std::size_t* offsets = springs.offsets + piece.first;
  const double* numbers = springs.numbers + piece.number;
  const auto column = [height](const double* from) {
    return Vector3<N>{N::of(from), N::of(from + height), N::of(from + 2 * height)};
  };
  for (std::size_t n = piece.begin; n < end; n += WIDE) {
    const double *x = planes.x + n, *v = planes.v + n;
    double *f = planes.f + n, *stored = planes.stored + EDGE + (n - piece.begin);
    const Vector3<N> here = column(x), speed = column(v);
    Vector3<N> sum = column(f);
    for (std::size_t b = 0; b < count; ++b, numbers += 3 * WIDE, stored += 3 * STORED) {
      const Vector3<N> d = here - column(x + offsets[b]), e = speed - column(v + offsets[b]);
      const Vector3<N> force =
          d * force_over_length(N::of(numbers), N::of(numbers + WIDE), N::of(numbers + 2 * WIDE),
                                dot(d, d), dot(d, e));
      sum -= force;
      force.x.store(stored), force.y.store(stored + STORED), force.z.store(stored + 2 * STORED);
    }
    sum.x.store(f), sum.y.store(f + height), sum.z.store(f + 2 * height);
  }
}

// Adds the stored forces of some offsets at the second ends.
template <class On, std::size_t... B>
void pull_grouped(std::index_sequence<B...>, const std::size_t* offsets, const double* stored,
                  std::size_t begin, std::size_t end, double* forces) {
  const std::size_t last = offsets[sizeof...(B) - 1];
  const std::size_t back[] = {begin + offsets[B]...};
  for (std::size_t n = (begin + offsets[0]) / WIDE * WIDE; n < end + last; n += WIDE) {
    Four<On> sum = Four<On>::of(forces + n);
    ((sum += Four<On>::of(stored + 3 * B * STORED + (EDGE + n - back[B]))), ...);
    sum.store(forces + n);
  }
}

// Adds the forces of a piece's springs at their second ends, after all are computed: loading a
// value right after it was stored at an overlapping address would stall.
template <class On>
void pull_ends(const BandPieces& springs, const BandPiece& piece, const BandPlanes& planes) {
  for (std::size_t row = 0; row < 3 * piece.count; ++row)
    for (std::size_t n = 0; n < EDGE; n += WIDE)
      Four<On>(0.0).store(planes.stored + row * STORED + EDGE + (piece.end - piece.begin) + n);
  const std::size_t* offsets = springs.offsets + piece.first;
  for (std::size_t b = 0, count; b < piece.count; b += count) {
    for (count = 1; count < TOGETHER && b + count < piece.count; ++count)
      if (offsets[b + count] > offsets[b] + GROUPED) break;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto add = [&](auto grouped) {
        pull_grouped<On>(grouped, offsets + b, planes.stored + (3 * b + k) * STORED, piece.begin,
                         piece.end, planes.f + k * planes.height);
      };
      if (count == 1) add(std::make_index_sequence<1>());
      if (count == 2) add(std::make_index_sequence<2>());
      if (count == TOGETHER) add(std::make_index_sequence<TOGETHER>());
    }
  }
}

// Advances the particles of a piece by the forces on them, and clears these: velocities first, then
// positions with the new velocities. Held particles stay.
template <class On>
void advance_piece(const BandPiece& piece, const PlaneSteps& steps, const BandPlanes& planes) {
  using N = Four<On>;
  const N zero = 0.0;
  for (std::size_t n = piece.begin; n < piece.end; n += WIDE) {
    const N inverse = N::of(steps.inverse_masses + n), drag = N::of(steps.drags + n);
    const N free = less(zero, inverse);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t at = k * planes.height + n;
      const N x = N::of(planes.x + at), v = N::of(planes.v + at);
      const N rate = N::of(planes.f + at) * inverse + (steps.fall[k] - drag * v);
      const N speed = v + steps.h * rate;
      select(free, speed, v).store(planes.v + at);
      select(free, x + steps.h * speed, x).store(planes.x + at);
      zero.store(planes.f + at);
    }
  }
}

// Adds the forces of springs to planes of forces.
template <class On>
void pull_planes(const BandPieces& springs, const BandPlanes& planes) {
  for (std::size_t p = 0; p < springs.count; ++p) {
    pull_begins<On>(springs, springs.pieces[p], planes);
    pull_ends<On>(springs, springs.pieces[p], planes);
  }
}

// One step of particles under the forces of springs and of the planes. Pieces are in the order of
// their particles, and none reads particles of an earlier one, which may already be advanced.
template <class On>
void step_planes(const BandPieces& springs, const PlaneSteps& steps, const BandPlanes& planes) {
  for (std::size_t p = 0; p < springs.count; ++p) {
    pull_begins<On>(springs, springs.pieces[p], planes);
    pull_ends<On>(springs, springs.pieces[p], planes);
    advance_piece<On>(springs.pieces[p], steps, planes);
  }
}

}  // namespace animtool
