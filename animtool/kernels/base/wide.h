// Numbers and vectors of several things side by side, whichever way a processor holds them.
//
// Nothing here is shared between source files, which are built for other processors: W is
// another type in each.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "base/rows.h"
#include "base/vector.h"

namespace animtool {

template <class W>
struct Wide {
  using Row = typename W::Row;
  Row row;

  Wide() = default;
  Wide(const Row& from) : row(from) {}
  Wide(double value) requires(!std::is_same_v<Row, double>) : row(W::spread(value)) {}

  static Wide of(const double* from) { return W::load(from); }
  void store(double* to) const { W::store(row, to); }

  friend Wide operator+(const Wide& a, const Wide& b) { return W::add(a.row, b.row); }
  friend Wide operator-(const Wide& a, const Wide& b) { return W::subtract(a.row, b.row); }
  friend Wide operator*(const Wide& a, const Wide& b) { return W::multiply(a.row, b.row); }
  friend Wide operator/(const Wide& a, const Wide& b) { return W::divide(a.row, b.row); }
  friend Wide root(const Wide& a) { return W::root(a.row); }
  // One over what is above 0, else 0.
  friend Wide inverse(const Wide& a) { return W::inverse(a.row); }
  friend Wide least(const Wide& a, const Wide& b) { return W::least(a.row, b.row); }
  friend Wide most(const Wide& a, const Wide& b) { return W::most(a.row, b.row); }
  // What `chosen` and `bits` take.
  friend Wide below(const Wide& a, const Wide& b) { return W::below(a.row, b.row); }
  friend Wide chosen(const Wide& where, const Wide& a, const Wide& b) {
    return W::chosen(where.row, a.row, b.row);
  }
  // A value where `below` says so, else 0.
  friend Wide kept(const Wide& where, const Wide& a) { return W::kept(where.row, a.row); }
  friend Wide either(const Wide& a, const Wide& b) { return W::either(a.row, b.row); }
  friend unsigned bits(const Wide& where) { return W::bits(where.row); }
  friend double largest(const Wide& a) { return W::largest(a.row); }
  friend double smallest(const Wide& a) { return W::smallest(a.row); }
};

template <class W>
double total(const Wide<W>& a) {
  double of[WIDE];
  a.store(of);
  return (of[0] + of[1]) + (of[2] + of[3]);
}

// Four rows to their columns.
template <class W>
void turn(const Wide<W>* rows, Wide<W>* columns) {
  typename W::Row at[WIDE] = {rows[0].row, rows[1].row, rows[2].row, rows[3].row};
  W::turn(at);
  for (std::size_t k = 0; k < WIDE; ++k) columns[k] = at[k];
}

// The total of each of four.
template <class W>
Wide<W> totals(const Wide<W>* rows) {
  Wide<W> of[WIDE];
  turn(rows, of);
  return (of[0] + of[1]) + (of[2] + of[3]);
}

// Rows in memory as columns.
template <class W>
void gather(const double* from, const std::int32_t* rows, Wide<W>* columns) {
  for (std::size_t k = 0; k < WIDE; ++k) columns[k] = Wide<W>::of(from + 4 * rows[k]);
  turn(columns, columns);
}

// Takes columns away from rows in memory, one after the other.
template <class W>
void scatter(const Wide<W>* columns, const std::int32_t* rows, double* to) {
  Wide<W> parts[WIDE];
  turn(columns, parts);
  for (std::size_t k = 0; k < WIDE; ++k)
    (Wide<W>::of(to + 4 * rows[k]) - parts[k]).store(to + 4 * rows[k]);
}

// Numbers from one vector of four to the next in memory.
constexpr std::size_t WIDE_VECTOR = 12;

template <class W>
using WideVec = Vector3<Wide<W>>;

template <class W>
WideVec<W> chosen(const Wide<W>& where, const WideVec<W>& a, const WideVec<W>& b) {
  return {chosen(where, a.x, b.x), chosen(where, a.y, b.y), chosen(where, a.z, b.z)};
}

}  // namespace animtool
