// Registers of four doubles, for sources that the build lets the compiler use them in: these
// have ANIMTOOL_QUADS, and ask the processor before they run.
#pragma once

#include "base/processor.h"
#include "base/rows.h"

#if defined(__AVX2__) && defined(__GNUC__)
#define ANIMTOOL_QUADS
#include <immintrin.h>

namespace animtool {

namespace {

struct QuadRows {
  using Row = __m256d;

  static Row load(const double* from) { return _mm256_loadu_pd(from); }
  static void store(Row row, double* to) { _mm256_storeu_pd(to, row); }
  static Row spread(double value) { return _mm256_set1_pd(value); }
  static Row add(Row a, Row b) { return _mm256_add_pd(a, b); }
  static Row subtract(Row a, Row b) { return _mm256_sub_pd(a, b); }
  static Row multiply(Row a, Row b) { return _mm256_mul_pd(a, b); }
  static Row where_apart(Row a, Row value) {
    return _mm256_and_pd(_mm256_cmp_pd(a, spread(ONE_PLACE), _CMP_GT_OQ), value);
  }
  static Row inverse(Row a) { return where_apart(a, _mm256_div_pd(_mm256_set1_pd(1), a)); }
  static Row root(Row a) { return _mm256_sqrt_pd(a); }
  static Row divide(Row a, Row b) { return _mm256_div_pd(a, b); }
  static Row least(Row a, Row b) { return _mm256_min_pd(a, b); }
  static Row most(Row a, Row b) { return _mm256_max_pd(a, b); }
  static Row below(Row a, Row b) { return _mm256_cmp_pd(a, b, _CMP_LT_OQ); }
  static Row chosen(Row where, Row a, Row b) { return _mm256_blendv_pd(b, a, where); }
  static Row kept(Row where, Row a) { return _mm256_and_pd(where, a); }
  static Row either(Row a, Row b) { return _mm256_or_pd(a, b); }
  static double largest(Row a) {
    const __m128d two = _mm_max_pd(_mm256_castpd256_pd128(a), _mm256_extractf128_pd(a, 1));
    return _mm_cvtsd_f64(_mm_max_sd(two, _mm_unpackhi_pd(two, two)));
  }
  static double smallest(Row a) {
    const __m128d two = _mm_min_pd(_mm256_castpd256_pd128(a), _mm256_extractf128_pd(a, 1));
    return _mm_cvtsd_f64(_mm_min_sd(two, _mm_unpackhi_pd(two, two)));
  }
  static unsigned bits(Row where) {
    return static_cast<unsigned>(_mm256_movemask_pd(where));
  }
  static Row dots(const Row* a, const Row* b) {
    const Row low = _mm256_hadd_pd(_mm256_mul_pd(a[0], b[0]), _mm256_mul_pd(a[1], b[1]));
    const Row high = _mm256_hadd_pd(_mm256_mul_pd(a[2], b[2]), _mm256_mul_pd(a[3], b[3]));
    const Row crossed = _mm256_permute2f128_pd(low, high, 0x21);
    const Row kept = _mm256_blend_pd(low, high, 0xC);
    return _mm256_add_pd(kept, crossed);
  }
  static void turn(Row* rows) {
    const Row a = _mm256_unpacklo_pd(rows[0], rows[1]), b = _mm256_unpackhi_pd(rows[0], rows[1]);
    const Row c = _mm256_unpacklo_pd(rows[2], rows[3]), d = _mm256_unpackhi_pd(rows[2], rows[3]);
    rows[0] = _mm256_permute2f128_pd(a, c, 0x20);
    rows[1] = _mm256_permute2f128_pd(b, d, 0x20);
    rows[2] = _mm256_permute2f128_pd(a, c, 0x31);
    rows[3] = _mm256_permute2f128_pd(b, d, 0x31);
  }
};

}  // namespace

}  // namespace animtool

#endif
