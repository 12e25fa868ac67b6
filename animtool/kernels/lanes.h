// Four numbers side by side, whichever way a processor holds them, and rows of four in memory.
//
// Nothing here is shared between source files, which are built for other processors.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#if defined(__AVX2__) && defined(__GNUC__)
#define ANIMTOOL_QUADS
#include <immintrin.h>
#endif

namespace animtool {

constexpr std::size_t LANES = 4;

namespace {

struct PlainLanes {
  struct D {
    double of[LANES];

    template <class Do>
    static D each(Do make) {
      D row;
      for (std::size_t k = 0; k < LANES; ++k) row.of[k] = make(k);
      return row;
    }
    friend D operator+(const D& a, const D& b) {
      return each([&](std::size_t k) { return a.of[k] + b.of[k]; });
    }
    friend D operator-(const D& a, const D& b) {
      return each([&](std::size_t k) { return a.of[k] - b.of[k]; });
    }
    friend D operator*(const D& a, const D& b) {
      return each([&](std::size_t k) { return a.of[k] * b.of[k]; });
    }
    friend D operator/(const D& a, const D& b) {
      return each([&](std::size_t k) { return a.of[k] / b.of[k]; });
    }
  };

  static D spread(double value) {
    return D::each([&](std::size_t) { return value; });
  }
  static D load(const double* from) {
    return D::each([&](std::size_t k) { return from[k]; });
  }
  static void store(const D& a, double* to) { std::copy_n(a.of, LANES, to); }
  static D below(const D& a, const D& b) {
    return D::each([&](std::size_t k) { return a.of[k] < b.of[k] ? 1.0 : 0.0; });
  }
  static D most(const D& a, const D& b) {
    return D::each([&](std::size_t k) { return a.of[k] > b.of[k] ? a.of[k] : b.of[k]; });
  }
  static D where(const D& which, const D& value) {
    return D::each([&](std::size_t k) { return which.of[k] != 0 ? value.of[k] : 0.0; });
  }
  static bool any(const D& a) {
    return a.of[0] != 0 || a.of[1] != 0 || a.of[2] != 0 || a.of[3] != 0;
  }
  static D root(const D& a) {
    return D::each([&](std::size_t k) { return std::sqrt(a.of[k]); });
  }
  static double total(const D& a) { return (a.of[0] + a.of[1]) + (a.of[2] + a.of[3]); }
  // The totals of four.
  static D fold(const D* columns) {
    return D::each([&](std::size_t k) { return total(columns[k]); });
  }
  static void gather(const double* from, const std::int32_t* rows, D* columns) {
    for (std::size_t k = 0; k < 4; ++k)
      columns[k] = D::each([&](std::size_t i) { return from[4 * rows[i] + static_cast<std::int32_t>(k)]; });
  }
  static void scatter(const D* columns, const std::int32_t* rows, double* to) {
    for (std::size_t i = 0; i < LANES; ++i)
      for (std::size_t k = 0; k < 4; ++k) to[4 * rows[i] + static_cast<std::int32_t>(k)] -= columns[k].of[i];
  }
};

#ifdef ANIMTOOL_QUADS

struct QuadLanes {
  struct D {
    __m256d row;
    friend D operator+(D a, D b) { return {_mm256_add_pd(a.row, b.row)}; }
    friend D operator-(D a, D b) { return {_mm256_sub_pd(a.row, b.row)}; }
    friend D operator*(D a, D b) { return {_mm256_mul_pd(a.row, b.row)}; }
    friend D operator/(D a, D b) { return {_mm256_div_pd(a.row, b.row)}; }
  };

  static D spread(double value) { return {_mm256_set1_pd(value)}; }
  static D load(const double* from) { return {_mm256_loadu_pd(from)}; }
  static void store(D a, double* to) { _mm256_storeu_pd(to, a.row); }
  static D below(D a, D b) { return {_mm256_cmp_pd(a.row, b.row, _CMP_LT_OQ)}; }
  static D most(D a, D b) { return {_mm256_max_pd(a.row, b.row)}; }
  static D where(D which, D value) { return {_mm256_and_pd(which.row, value.row)}; }
  static D root(D a) { return {_mm256_sqrt_pd(a.row)}; }
  static bool any(D which) { return _mm256_movemask_pd(which.row) != 0; }
  static double total(D a) {
    double of[4];
    store(a, of);
    return (of[0] + of[1]) + (of[2] + of[3]);
  }
  static void turn(D* rows) {
    const __m256d a = _mm256_unpacklo_pd(rows[0].row, rows[1].row);
    const __m256d b = _mm256_unpackhi_pd(rows[0].row, rows[1].row);
    const __m256d c = _mm256_unpacklo_pd(rows[2].row, rows[3].row);
    const __m256d d = _mm256_unpackhi_pd(rows[2].row, rows[3].row);
    rows[0].row = _mm256_permute2f128_pd(a, c, 0x20);
    rows[1].row = _mm256_permute2f128_pd(b, d, 0x20);
    rows[2].row = _mm256_permute2f128_pd(a, c, 0x31);
    rows[3].row = _mm256_permute2f128_pd(b, d, 0x31);
  }
  static D fold(const D* columns) {
    D rows[4] = {columns[0], columns[1], columns[2], columns[3]};
    turn(rows);
    return (rows[0] + rows[1]) + (rows[2] + rows[3]);
  }
  static void gather(const double* from, const std::int32_t* rows, D* columns) {
    for (std::size_t k = 0; k < 4; ++k) columns[k] = load(from + 4 * rows[k]);
    turn(columns);
  }
  static void scatter(const D* columns, const std::int32_t* rows, double* to) {
    D parts[4] = {columns[0], columns[1], columns[2], columns[3]};
    turn(parts);
    for (std::size_t k = 0; k < 4; ++k)
      store(load(to + 4 * rows[k]) - parts[k], to + 4 * rows[k]);
  }
};

#endif

}  // namespace

}  // namespace animtool
