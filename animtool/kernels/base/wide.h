// SIMD numbers for any processor, and vectors of them.
//
// Functions on them are templates over `On`: Plain for any processor, or Quads of base/quads.h.
// Source files that are built for different processors share no instances: Quads is a different
// type in each, and files that use it instantiate nothing for Plain or plain vectors.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

#include "base/vector.h"

namespace animtool {

// Numbers per SIMD vector.
constexpr std::size_t WIDE = 4;
// Two points with at most this squared distance count as coincident; the reciprocal of larger ones
// is finite.
constexpr double COINCIDENT = std::numeric_limits<double>::min();

struct Plain {};

// Rows of N numbers and their operations. A mask row is nonzero where a condition holds; masks
// are arguments of `chosen`, `kept`, `either` and `bits`.
template <class T, std::size_t N, class On>
struct Registers {
  struct Row {
    T at[N];
  };

  template <class Function>
  static Row each(Function function) {
    Row row;
    for (std::size_t l = 0; l < N; ++l) row.at[l] = function(l);
    return row;
  }
  template <class Other>
  static Row converted(const Other& a) {
    return each([&](std::size_t l) { return static_cast<T>(a.at[l]); });
  }
  static Row load(const T* from) {
    return each([&](std::size_t l) { return from[l]; });
  }
  static void store(const Row& row, T* to) {
    for (std::size_t l = 0; l < N; ++l) to[l] = row.at[l];
  }
  static Row broadcast(T value) {
    return each([&](std::size_t) { return value; });
  }
  static Row negate(const Row& a) {
    return each([&](std::size_t l) { return -a.at[l]; });
  }
  static Row add(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] + b.at[l]; });
  }
  static Row subtract(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] - b.at[l]; });
  }
  static Row multiply(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] * b.at[l]; });
  }
  static Row divide(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] / b.at[l]; });
  }
  static Row sqrt(const Row& a) {
    return each([&](std::size_t l) { return std::sqrt(a.at[l]); });
  }
  static Row min(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] < b.at[l] ? a.at[l] : b.at[l]; });
  }
  static Row max(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] > b.at[l] ? a.at[l] : b.at[l]; });
  }
  static Row less(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return T(a.at[l] < b.at[l]); });
  }
  static Row select(const Row& where, const Row& a, const Row& b) {
    return each([&](std::size_t l) { return where.at[l] != 0 ? a.at[l] : b.at[l]; });
  }
  static Row masked(const Row& where, const Row& a) { return select(where, a, broadcast(0)); }
  static Row mask_or(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return T(a.at[l] != 0 || b.at[l] != 0); });
  }
  static unsigned mask_bits(const Row& where) {
    unsigned set_bits = 0;
    for (std::size_t l = 0; l < N; ++l) set_bits |= (where.at[l] != 0 ? 1u : 0u) << l;
    return set_bits;
  }
  // Adds by halves, in the order of the registers.
  static T largest(Row a) {
    for (std::size_t half = N / 2; half; half /= 2)
      for (std::size_t l = 0; l < half; ++l)
        a.at[l] = a.at[l] > a.at[l + half] ? a.at[l] : a.at[l + half];
    return a.at[0];
  }
  static T smallest(const Row& a) { return -largest(negate(a)); }
  static Row totals(const Row* rows) {
    return each([&](std::size_t l) {
      const T* of = rows[l].at;
      return (of[0] + of[1]) + (of[2] + of[3]);
    });
  }
  static void transpose(Row* rows) {
    for (std::size_t k = 0; k < N; ++k)
      for (std::size_t l = 0; l < k; ++l) std::swap(rows[k].at[l], rows[l].at[k]);
  }
};

#if defined(__GNUC__)
// Two doubles: every processor has registers for them.
template <>
struct Registers<double, 2, Plain> {
  using Row = double __attribute__((vector_size(16)));

  template <class Function>
  static Row each(Function function) {
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
  static Row select(Row where, Row a, Row b) {
    return reinterpret_cast<decltype(a < b)>(where) ? a : b;
  }
};
#endif

template <class T, std::size_t N, class On>
struct Wide {
  using Of = Registers<T, N, On>;
  static constexpr std::size_t LANES = N;
  typename Of::Row row;

  Wide() = default;
  Wide(const typename Of::Row& from) : row(from) {}
  Wide(T value) : row(Of::broadcast(value)) {}
  // Converts from the other number type.
  template <class U>
  explicit Wide(const Wide<U, N, On>& other) : row(Of::converted(other.row)) {}

  static Wide of(const T* from) { return Of::load(from); }
  // Calls function(lane) for each lane.
  template <class Function>
  static Wide each(Function function) {
    return Of::each(function);
  }
  void store(T* to) const { Of::store(row, to); }

  friend Wide operator-(const Wide& a) { return Of::negate(a.row); }
  friend Wide operator+(const Wide& a, const Wide& b) { return Of::add(a.row, b.row); }
  friend Wide operator-(const Wide& a, const Wide& b) { return Of::subtract(a.row, b.row); }
  friend Wide operator*(const Wide& a, const Wide& b) { return Of::multiply(a.row, b.row); }
  friend Wide operator/(const Wide& a, const Wide& b) { return Of::divide(a.row, b.row); }
  friend Wide& operator+=(Wide& a, const Wide& b) { return a = a + b; }
  friend Wide sqrt(const Wide& a) { return Of::sqrt(a.row); }
  friend Wide min(const Wide& a, const Wide& b) { return Of::min(a.row, b.row); }
  friend Wide max(const Wide& a, const Wide& b) { return Of::max(a.row, b.row); }
  friend Wide less(const Wide& a, const Wide& b) { return Of::less(a.row, b.row); }
  friend Wide select(const Wide& where, const Wide& a, const Wide& b) {
    return Of::select(where.row, a.row, b.row);
  }
  // The value where the mask is set, else 0.
  friend Wide masked(const Wide& where, const Wide& a) { return Of::masked(where.row, a.row); }
  friend Wide mask_or(const Wide& a, const Wide& b) { return Of::mask_or(a.row, b.row); }
  friend unsigned mask_bits(const Wide& where) { return Of::mask_bits(where.row); }
  friend T largest(const Wide& a) { return Of::largest(a.row); }
  friend T smallest(const Wide& a) { return Of::smallest(a.row); }

  // The value, or 0 where the squared distance says that both ends coincide.
  friend Wide if_distinct(const Wide& square, const Wide& value) {
    return masked(less(T(COINCIDENT), square), value);
  }
  // Reciprocal of a squared distance, 0 for coincident ends.
  friend Wide inverse(const Wide& square) { return if_distinct(square, T(1) / square); }

  // The sums of four rows.
  friend Wide totals(const Wide* rows) {
    const typename Of::Row of[WIDE] = {rows[0].row, rows[1].row, rows[2].row, rows[3].row};
    return Of::totals(of);
  }
  // Transposes four rows.
  friend void transpose(const Wide* rows, Wide* columns) {
    typename Of::Row of[WIDE] = {rows[0].row, rows[1].row, rows[2].row, rows[3].row};
    Of::transpose(of);
    for (std::size_t k = 0; k < WIDE; ++k) columns[k] = of[k];
  }
  friend T total(const Wide& a) {
    T of[WIDE];
    a.store(of);
    return (of[0] + of[1]) + (of[2] + of[3]);
  }
};

template <class On>
using Four = Wide<double, WIDE, On>;
template <class On>
using FourVec = Vector3<Four<On>>;
// Stride from one vector of four to the next.
constexpr std::size_t WIDE_VECTOR = 12;

// The dot products of four pairs of rows.
template <class On>
Four<On> dots(const Four<On>* a, const Four<On>* b) {
  const Four<On> products[WIDE] = {a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]};
  return totals(products);
}

// Loads rows from memory and transposes them.
template <class On>
inline void gather(const double* from, const std::int32_t* rows, Four<On>* columns) {
  for (std::size_t k = 0; k < WIDE; ++k) columns[k] = Four<On>::of(from + 4 * rows[k]);
  transpose(columns, columns);
}

// Subtracts columns from rows in memory, one row at a time.
template <class On>
inline void scatter(const Four<On>* columns, const std::int32_t* rows, double* to) {
  Four<On> parts[WIDE];
  transpose(columns, parts);
  for (std::size_t k = 0; k < WIDE; ++k)
    (Four<On>::of(to + 4 * rows[k]) - parts[k]).store(to + 4 * rows[k]);
}

template <class N>
Vector3<N> select(const N& where, const Vector3<N>& a, const Vector3<N>& b) {
  return {select(where, a.x, b.x), select(where, a.y, b.y), select(where, a.z, b.z)};
}

}  // namespace animtool
