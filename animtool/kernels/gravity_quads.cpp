// Sums of gravity for processors with registers of four doubles; the build says where the
// compiler may use them, and the processor is asked before it runs.
#include "gravity_lanes.h"
#include "quads.h"

namespace animtool {

#ifdef ANIMTOOL_QUADS

namespace {

struct QuadLanes {
  struct F {
    __m256 row;
    friend F operator+(F a, F b) { return {_mm256_add_ps(a.row, b.row)}; }
    friend F operator-(F a, F b) { return {_mm256_sub_ps(a.row, b.row)}; }
    friend F operator*(F a, F b) { return {_mm256_mul_ps(a.row, b.row)}; }
  };
  struct D {
    __m256d low, high;
    friend D operator+(D a, D b) {
      return {_mm256_add_pd(a.low, b.low), _mm256_add_pd(a.high, b.high)};
    }
    friend D operator-(D a, D b) {
      return {_mm256_sub_pd(a.low, b.low), _mm256_sub_pd(a.high, b.high)};
    }
    friend D operator*(D a, D b) {
      return {_mm256_mul_pd(a.low, b.low), _mm256_mul_pd(a.high, b.high)};
    }
  };

  static F spread(float value) { return {_mm256_set1_ps(value)}; }
  static D spread(double value) { return {_mm256_set1_pd(value), _mm256_set1_pd(value)}; }
  static F load(const float* from) { return {_mm256_loadu_ps(from)}; }
  static D load(const double* from) {
    return {_mm256_loadu_pd(from), _mm256_loadu_pd(from + 4)};
  }
  static void store(D a, double* to) {
    _mm256_storeu_pd(to, a.low);
    _mm256_storeu_pd(to + 4, a.high);
  }
  static void add(D a, double* to) { store(load(to) + a, to); }
  static void raise(D a, double* to) { store(most(load(to), a), to); }
  static F narrow(D a) {
    return {_mm256_set_m128(_mm256_cvtpd_ps(a.high), _mm256_cvtpd_ps(a.low))};
  }
  static D widen(F a) {
    return {_mm256_cvtps_pd(_mm256_castps256_ps128(a.row)),
            _mm256_cvtps_pd(_mm256_extractf128_ps(a.row, 1))};
  }
  static F inverse_root(F a) {
    return {_mm256_div_ps(_mm256_set1_ps(1), _mm256_sqrt_ps(a.row))};
  }
  static F where_above(F a, float least, F value) {
    const __m256 above = _mm256_cmp_ps(a.row, _mm256_set1_ps(least), _CMP_GT_OQ);
    return {_mm256_and_ps(above, value.row)};
  }
  static F most(F a, F b) { return {_mm256_max_ps(a.row, b.row)}; }
  static D most(D a, D b) {
    return {_mm256_max_pd(a.low, b.low), _mm256_max_pd(a.high, b.high)};
  }
};

}  // namespace

const GravityFunctions* gravity_in_quads() {
  return has_quads() ? &GravityLoops<QuadLanes>::functions : nullptr;
}

#else

const GravityFunctions* gravity_in_quads() { return nullptr; }

#endif

}  // namespace animtool
