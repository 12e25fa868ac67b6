// Four numbers side by side, as `Wide` and loops over springs and molecules work on them;
// `quads.h` has the same for processors with registers of four doubles.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>

namespace animtool {

// Numbers that are worked on at once.
constexpr std::size_t WIDE = 4;
// Up to this square of their distance two ends are at one place; one over more is finite.
constexpr double ONE_PLACE = std::numeric_limits<double>::min();

// Four numbers of springs, particles or molecules, on any processor.
struct PlainRows {
  struct Row {
    double at[WIDE];
  };

  template <class Function>
  static Row each(Function function) {
    Row row;
    for (std::size_t l = 0; l < WIDE; ++l) row.at[l] = function(l);
    return row;
  }
  static Row load(const double* from) {
    return each([&](std::size_t l) { return from[l]; });
  }
  static void store(const Row& row, double* to) {
    for (std::size_t l = 0; l < WIDE; ++l) to[l] = row.at[l];
  }
  static Row spread(double value) {
    return each([&](std::size_t) { return value; });
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
  // One over the square of a distance, 0 of ends at one place.
  static Row inverse(const Row& a) {
    return each([&](std::size_t l) { return a.at[l] > ONE_PLACE ? 1 / a.at[l] : 0.0; });
  }
  // A value of springs, by the square of their length: 0 of ends at one place.
  static Row where_apart(const Row& a, const Row& value) {
    return each([&](std::size_t l) { return a.at[l] > ONE_PLACE ? value.at[l] : 0.0; });
  }
  static Row root(const Row& a) {
    return each([&](std::size_t l) { return std::sqrt(a.at[l]); });
  }
  static Row divide(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] / b.at[l]; });
  }
  static Row least(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] < b.at[l] ? a.at[l] : b.at[l]; });
  }
  static Row most(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] > b.at[l] ? a.at[l] : b.at[l]; });
  }
  // What `chosen` and `bits` take: where one is below another.
  static Row below(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] < b.at[l] ? 1.0 : 0.0; });
  }
  static Row chosen(const Row& where, const Row& a, const Row& b) {
    return each([&](std::size_t l) { return where.at[l] != 0 ? a.at[l] : b.at[l]; });
  }
  // A value where `below` says so, else 0.
  static Row kept(const Row& where, const Row& a) {
    return each([&](std::size_t l) { return where.at[l] != 0 ? a.at[l] : 0.0; });
  }
  static Row either(const Row& a, const Row& b) {
    return each([&](std::size_t l) { return a.at[l] != 0 || b.at[l] != 0 ? 1.0 : 0.0; });
  }
  static double largest(const Row& a) {
    const double p = a.at[0] > a.at[2] ? a.at[0] : a.at[2];
    const double q = a.at[1] > a.at[3] ? a.at[1] : a.at[3];
    return p > q ? p : q;
  }
  static double smallest(const Row& a) {
    const double p = a.at[0] < a.at[2] ? a.at[0] : a.at[2];
    const double q = a.at[1] < a.at[3] ? a.at[1] : a.at[3];
    return p < q ? p : q;
  }
  static unsigned bits(const Row& where) {
    unsigned found = 0;
    for (std::size_t l = 0; l < WIDE; ++l) found |= (where.at[l] != 0 ? 1u : 0u) << l;
    return found;
  }
  // The products of four pairs of particles' rows.
  static Row dots(const Row* a, const Row* b) {
    return each([&](std::size_t l) {
      const double *p = a[l].at, *q = b[l].at;
      return p[0] * q[0] + p[1] * q[1] + (p[2] * q[2] + p[3] * q[3]);
    });
  }
  // Four rows to their columns.
  static void turn(Row* rows) {
    for (std::size_t k = 0; k < WIDE; ++k)
      for (std::size_t l = 0; l < k; ++l) std::swap(rows[k].at[l], rows[l].at[k]);
  }
};

}  // namespace animtool
