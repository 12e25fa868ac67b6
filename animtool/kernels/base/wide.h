// SIMD numbers for any processor, and vectors of them.
//
// Functions on them are templates over `Simd`: Portable for any processor, or Quads of
// base/quads.h. Source files that are built for different processors share no instances: Quads is a
// different type in each, and files that use it instantiate nothing for Portable or for scalar
// vectors.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

#include "base/vector.h"

namespace animtool {

// Numbers per SIMD register.
constexpr std::size_t SIMD_WIDTH = 4;
// Two points with at most this squared distance count as coincident; the reciprocal of a larger
// squared distance is finite.
constexpr double COINCIDENT_SQUARED = std::numeric_limits<double>::min();

// Operations that every processor has.
struct Portable {};

// Rows of N numbers and their operations. A mask row is nonzero where a condition holds; masks are
// arguments of `select`, `masked`, `mask_or` and `mask_bits`.
template <class T, std::size_t N, class Simd>
struct Registers {
  struct Row {
    T lanes[N];
  };

  template <class Function>
  static Row generate(Function function) {
    Row row;
    for (std::size_t l = 0; l < N; ++l) row.lanes[l] = function(l);
    return row;
  }
  template <class Other>
  static Row convert(const Other& a) {
    return generate([&](std::size_t l) { return static_cast<T>(a.lanes[l]); });
  }
  static Row load(const T* from) {
    return generate([&](std::size_t l) { return from[l]; });
  }
  static void store(const Row& row, T* to) {
    for (std::size_t l = 0; l < N; ++l) to[l] = row.lanes[l];
  }
  static Row broadcast(T value) {
    return generate([&](std::size_t) { return value; });
  }
  static Row negate(const Row& a) {
    return generate([&](std::size_t l) { return -a.lanes[l]; });
  }
  static Row add(const Row& a, const Row& b) {
    return generate([&](std::size_t l) { return a.lanes[l] + b.lanes[l]; });
  }
  static Row subtract(const Row& a, const Row& b) {
    return generate([&](std::size_t l) { return a.lanes[l] - b.lanes[l]; });
  }
  static Row multiply(const Row& a, const Row& b) {
    return generate([&](std::size_t l) { return a.lanes[l] * b.lanes[l]; });
  }
  static Row divide(const Row& a, const Row& b) {
    return generate([&](std::size_t l) { return a.lanes[l] / b.lanes[l]; });
  }
  static Row sqrt(const Row& a) {
    return generate([&](std::size_t l) { return std::sqrt(a.lanes[l]); });
  }
  static Row min(const Row& a, const Row& b) {
    return generate(
        [&](std::size_t l) { return a.lanes[l] < b.lanes[l] ? a.lanes[l] : b.lanes[l]; });
  }
  static Row max(const Row& a, const Row& b) {
    return generate(
        [&](std::size_t l) { return a.lanes[l] > b.lanes[l] ? a.lanes[l] : b.lanes[l]; });
  }
  static Row less(const Row& a, const Row& b) {
    return generate([&](std::size_t l) { return T(a.lanes[l] < b.lanes[l]); });
  }
  static Row select(const Row& mask, const Row& a, const Row& b) {
    return generate([&](std::size_t l) { return mask.lanes[l] != 0 ? a.lanes[l] : b.lanes[l]; });
  }
  static Row masked(const Row& mask, const Row& a) { return select(mask, a, broadcast(0)); }
  static Row mask_or(const Row& a, const Row& b) {
    return generate([&](std::size_t l) { return T(a.lanes[l] != 0 || b.lanes[l] != 0); });
  }
  static unsigned mask_bits(const Row& mask) {
    unsigned bits = 0;
    for (std::size_t l = 0; l < N; ++l) bits |= (mask.lanes[l] != 0 ? 1u : 0u) << l;
    return bits;
  }
  // Reduces by halves, in the order of the registers.
  static T largest(Row a) {
    for (std::size_t half = N / 2; half; half /= 2)
      for (std::size_t l = 0; l < half; ++l)
        a.lanes[l] = a.lanes[l] > a.lanes[l + half] ? a.lanes[l] : a.lanes[l + half];
    return a.lanes[0];
  }
  static T smallest(const Row& a) { return -largest(negate(a)); }
  // The sum of each of N rows.
  static Row totals(const Row* rows) {
    return generate([&](std::size_t l) {
      const T* numbers = rows[l].lanes;
      return (numbers[0] + numbers[1]) + (numbers[2] + numbers[3]);
    });
  }
  static void transpose(Row* rows) {
    for (std::size_t k = 0; k < N; ++k)
      for (std::size_t l = 0; l < k; ++l) std::swap(rows[k].lanes[l], rows[l].lanes[k]);
  }
};

#if defined(__GNUC__)
// Two doubles: every processor has registers for them.
template <>
struct Registers<double, 2, Portable> {
  using Row = double __attribute__((vector_size(16)));

  template <class Function>
  static Row generate(Function function) {
    return Row{function(0), function(1)};
  }
  static Row load(const double* from) { return Row{from[0], from[1]}; }
  static void store(Row row, double* to) { to[0] = row[0], to[1] = row[1]; }
  static Row broadcast(double value) { return Row{value, value}; }
  static Row negate(Row a) { return -a; }
  static Row add(Row a, Row b) { return a + b; }
  static Row subtract(Row a, Row b) { return a - b; }
  static Row multiply(Row a, Row b) { return a * b; }
  static Row divide(Row a, Row b) { return a / b; }
  static Row less(Row a, Row b) { return reinterpret_cast<Row>(a < b); }
  static Row select(Row mask, Row a, Row b) {
    return reinterpret_cast<decltype(a < b)>(mask) ? a : b;
  }
};
#endif

// N numbers of type T that are processed together.
template <class T, std::size_t N, class Simd>
struct Wide {
  using Ops = Registers<T, N, Simd>;
  static constexpr std::size_t LANES = N;
  typename Ops::Row row;

  Wide() = default;
  Wide(const typename Ops::Row& from) : row(from) {}
  Wide(T value) : row(Ops::broadcast(value)) {}
  // Converts from the other number type.
  template <class U>
  explicit Wide(const Wide<U, N, Simd>& numbers) : row(Ops::convert(numbers.row)) {}

  static Wide load(const T* from) { return Ops::load(from); }
  // Calls function(lane) for each lane.
  template <class Function>
  static Wide generate(Function function) {
    return Ops::generate(function);
  }
  void store(T* to) const { Ops::store(row, to); }

  friend Wide operator-(const Wide& a) { return Ops::negate(a.row); }
  friend Wide operator+(const Wide& a, const Wide& b) { return Ops::add(a.row, b.row); }
  friend Wide operator-(const Wide& a, const Wide& b) { return Ops::subtract(a.row, b.row); }
  friend Wide operator*(const Wide& a, const Wide& b) { return Ops::multiply(a.row, b.row); }
  friend Wide operator/(const Wide& a, const Wide& b) { return Ops::divide(a.row, b.row); }
  friend Wide& operator+=(Wide& a, const Wide& b) { return a = a + b; }
  friend Wide sqrt(const Wide& a) { return Ops::sqrt(a.row); }
  friend Wide min(const Wide& a, const Wide& b) { return Ops::min(a.row, b.row); }
  friend Wide max(const Wide& a, const Wide& b) { return Ops::max(a.row, b.row); }
  friend Wide less(const Wide& a, const Wide& b) { return Ops::less(a.row, b.row); }
  friend Wide select(const Wide& mask, const Wide& a, const Wide& b) {
    return Ops::select(mask.row, a.row, b.row);
  }
  // The value where the mask is set, else 0.
  friend Wide masked(const Wide& mask, const Wide& a) { return Ops::masked(mask.row, a.row); }
  friend Wide mask_or(const Wide& a, const Wide& b) { return Ops::mask_or(a.row, b.row); }
  friend unsigned mask_bits(const Wide& mask) { return Ops::mask_bits(mask.row); }
  friend T largest(const Wide& a) { return Ops::largest(a.row); }
  friend T smallest(const Wide& a) { return Ops::smallest(a.row); }

  // Returns the value, or 0 where a squared distance says that the points coincide.
  friend Wide zero_if_coincident(const Wide& square, const Wide& value) {
    return masked(less(T(COINCIDENT_SQUARED), square), value);
  }
  // Reciprocal of a squared distance; 0 for coincident points.
  friend Wide inverse(const Wide& square) { return zero_if_coincident(square, T(1) / square); }

  // The sums of four rows.
  friend Wide totals(const Wide* rows) {
    const typename Ops::Row copies[SIMD_WIDTH] = {rows[0].row, rows[1].row, rows[2].row,
                                                  rows[3].row};
    return Ops::totals(copies);
  }
  // Transposes four rows.
  friend void transpose(const Wide* rows, Wide* columns) {
    typename Ops::Row copies[SIMD_WIDTH] = {rows[0].row, rows[1].row, rows[2].row, rows[3].row};
    Ops::transpose(copies);
    for (std::size_t k = 0; k < SIMD_WIDTH; ++k) columns[k] = copies[k];
  }
  // The sum of four numbers.
  friend T total(const Wide& a) {
    T numbers[SIMD_WIDTH];
    a.store(numbers);
    return (numbers[0] + numbers[1]) + (numbers[2] + numbers[3]);
  }
};

// Four doubles, and four vectors.
template <class Simd>
using Four = Wide<double, SIMD_WIDTH, Simd>;
template <class Simd>
using FourVec = Vector3<Four<Simd>>;
// Doubles of a FourVec in memory.
constexpr std::size_t FOUR_VEC_SIZE = 12;

// The dot products of four pairs of rows.
template <class Simd>
Four<Simd> dots(const Four<Simd>* a, const Four<Simd>* b) {
  const Four<Simd> products[SIMD_WIDTH] = {a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]};
  return totals(products);
}

// Loads four rows from memory and transposes them.
template <class Simd>
inline void gather(const double* from, const std::int32_t* rows, Four<Simd>* columns) {
  for (std::size_t k = 0; k < SIMD_WIDTH; ++k) columns[k] = Four<Simd>::load(from + 4 * rows[k]);
  transpose(columns, columns);
}

// Subtracts columns from four rows in memory, one row at a time.
template <class Simd>
inline void scatter(const Four<Simd>* columns, const std::int32_t* rows, double* to) {
  Four<Simd> differences[SIMD_WIDTH];
  transpose(columns, differences);
  for (std::size_t k = 0; k < SIMD_WIDTH; ++k)
    (Four<Simd>::load(to + 4 * rows[k]) - differences[k]).store(to + 4 * rows[k]);
}

template <class N>
Vector3<N> select(const N& mask, const Vector3<N>& a, const Vector3<N>& b) {
  return {select(mask, a.x, b.x), select(mask, a.y, b.y), select(mask, a.z, b.z)};
}

}  // namespace animtool
