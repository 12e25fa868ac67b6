// SIMD registers of four doubles. Sources that use them are compiled for such processors, and test
// the processor before they run. In other builds, Quads is the same as Portable.
#pragma once

#include <cstdlib>

#include "base/wide.h"

#if defined(__AVX2__) && defined(__GNUC__)
#define ANIMTOOL_QUADS
#include <immintrin.h>
#endif

namespace animtool {

// Whether registers of four doubles may be used: the processor has them, and the environment
// variable ANIMTOOL_PORTABLE is not set. Static: a copy that is compiled for newer processors must
// not be linked into other sources.
[[maybe_unused]] static bool has_quads() {
#ifdef ANIMTOOL_QUADS
  return __builtin_cpu_supports("avx2") && !std::getenv("ANIMTOOL_PORTABLE");
#else
  return false;
#endif
}

#ifndef ANIMTOOL_QUADS

using Quads = Portable;

#else

namespace {

struct Quads {};

}  // namespace

template <>
struct Registers<double, 4, Quads> {
  using Row = __m256d;

  template <class Function>
  static Row generate(Function function) {
    return _mm256_setr_pd(function(0), function(1), function(2), function(3));
  }
  static Row load(const double* from) { return _mm256_loadu_pd(from); }
  static void store(Row row, double* to) { _mm256_storeu_pd(to, row); }
  static Row broadcast(double value) { return _mm256_set1_pd(value); }
  static Row add(Row a, Row b) { return _mm256_add_pd(a, b); }
  static Row subtract(Row a, Row b) { return _mm256_sub_pd(a, b); }
  static Row multiply(Row a, Row b) { return _mm256_mul_pd(a, b); }
  static Row divide(Row a, Row b) { return _mm256_div_pd(a, b); }
  static Row sqrt(Row a) { return _mm256_sqrt_pd(a); }
  static Row min(Row a, Row b) { return _mm256_min_pd(a, b); }
  static Row max(Row a, Row b) { return _mm256_max_pd(a, b); }
  static Row less(Row a, Row b) { return _mm256_cmp_pd(a, b, _CMP_LT_OQ); }
  static Row select(Row mask, Row a, Row b) { return _mm256_blendv_pd(b, a, mask); }
  static Row masked(Row mask, Row a) { return _mm256_and_pd(mask, a); }
  static Row mask_or(Row a, Row b) { return _mm256_or_pd(a, b); }
  static unsigned mask_bits(Row mask) { return static_cast<unsigned>(_mm256_movemask_pd(mask)); }
  static double largest(Row a) {
    const __m128d pair = _mm_max_pd(_mm256_castpd256_pd128(a), _mm256_extractf128_pd(a, 1));
    return _mm_cvtsd_f64(_mm_max_sd(pair, _mm_unpackhi_pd(pair, pair)));
  }
  static double smallest(Row a) {
    const __m128d pair = _mm_min_pd(_mm256_castpd256_pd128(a), _mm256_extractf128_pd(a, 1));
    return _mm_cvtsd_f64(_mm_min_sd(pair, _mm_unpackhi_pd(pair, pair)));
  }
  static Row totals(const Row* rows) {
    const Row low = _mm256_hadd_pd(rows[0], rows[1]), high = _mm256_hadd_pd(rows[2], rows[3]);
    return _mm256_add_pd(_mm256_blend_pd(low, high, 0xC), _mm256_permute2f128_pd(low, high, 0x21));
  }
  static void transpose(Row* rows) {
    const Row a = _mm256_unpacklo_pd(rows[0], rows[1]), b = _mm256_unpackhi_pd(rows[0], rows[1]);
    const Row c = _mm256_unpacklo_pd(rows[2], rows[3]), d = _mm256_unpackhi_pd(rows[2], rows[3]);
    rows[0] = _mm256_permute2f128_pd(a, c, 0x20);
    rows[1] = _mm256_permute2f128_pd(b, d, 0x20);
    rows[2] = _mm256_permute2f128_pd(a, c, 0x31);
    rows[3] = _mm256_permute2f128_pd(b, d, 0x31);
  }
};

template <>
struct Registers<float, 8, Quads> {
  using Row = __m256;

  template <class Doubles>
  static Row convert(const Doubles& a) {
    return _mm256_set_m128(_mm256_cvtpd_ps(a.high), _mm256_cvtpd_ps(a.low));
  }
  static Row load(const float* from) { return _mm256_loadu_ps(from); }
  static Row broadcast(float value) { return _mm256_set1_ps(value); }
  static Row add(Row a, Row b) { return _mm256_add_ps(a, b); }
  static Row subtract(Row a, Row b) { return _mm256_sub_ps(a, b); }
  static Row multiply(Row a, Row b) { return _mm256_mul_ps(a, b); }
  static Row divide(Row a, Row b) { return _mm256_div_ps(a, b); }
  static Row sqrt(Row a) { return _mm256_sqrt_ps(a); }
  static Row max(Row a, Row b) { return _mm256_max_ps(a, b); }
  static Row less(Row a, Row b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
  static Row masked(Row mask, Row a) { return _mm256_and_ps(mask, a); }
};

// Eight doubles, in two registers.
template <>
struct Registers<double, 8, Quads> {
  using Half = Registers<double, 4, Quads>;
  struct Row {
    __m256d low, high;
  };

  static Row convert(__m256 a) {
    return {_mm256_cvtps_pd(_mm256_castps256_ps128(a)),
            _mm256_cvtps_pd(_mm256_extractf128_ps(a, 1))};
  }
  static Row load(const double* from) { return {Half::load(from), Half::load(from + 4)}; }
  static void store(const Row& row, double* to) {
    Half::store(row.low, to), Half::store(row.high, to + 4);
  }
  static Row broadcast(double value) { return {Half::broadcast(value), Half::broadcast(value)}; }
  static Row add(const Row& a, const Row& b) {
    return {Half::add(a.low, b.low), Half::add(a.high, b.high)};
  }
  static Row subtract(const Row& a, const Row& b) {
    return {Half::subtract(a.low, b.low), Half::subtract(a.high, b.high)};
  }
  static Row multiply(const Row& a, const Row& b) {
    return {Half::multiply(a.low, b.low), Half::multiply(a.high, b.high)};
  }
  static Row max(const Row& a, const Row& b) {
    return {Half::max(a.low, b.low), Half::max(a.high, b.high)};
  }
};

#endif

}  // namespace animtool
