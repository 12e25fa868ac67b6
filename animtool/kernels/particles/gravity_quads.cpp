// Sums of gravity for processors with registers of four doubles; the build says where the
// compiler may use them, and the processor is asked before it runs.
#include "base/quads.h"
#include "particles/gravity_lanes.h"

namespace animtool {

#ifdef ANIMTOOL_QUADS

namespace {

struct QuadFloats {
  using F = QuadFloats;
  __m256 row;

  QuadFloats() = default;
  QuadFloats(__m256 from) : row(from) {}
  QuadFloats(float value) : row(_mm256_set1_ps(value)) {}
  explicit QuadFloats(const float* from) : row(_mm256_loadu_ps(from)) {}

  static F narrow(__m256d low, __m256d high) {
    return _mm256_set_m128(_mm256_cvtpd_ps(high), _mm256_cvtpd_ps(low));
  }
  void widen(__m256d& low, __m256d& high) const {
    low = _mm256_cvtps_pd(_mm256_castps256_ps128(row));
    high = _mm256_cvtps_pd(_mm256_extractf128_ps(row, 1));
  }
  friend F operator+(F a, F b) { return _mm256_add_ps(a.row, b.row); }
  friend F operator-(F a, F b) { return _mm256_sub_ps(a.row, b.row); }
  friend F operator*(F a, F b) { return _mm256_mul_ps(a.row, b.row); }
  friend F most(F a, F b) { return _mm256_max_ps(a.row, b.row); }
  friend F inverse_root(F a) {
    return _mm256_div_ps(_mm256_set1_ps(1), _mm256_sqrt_ps(a.row));
  }
  friend F where_above(F a, float least, F value) {
    return _mm256_and_ps(_mm256_cmp_ps(a.row, F(least).row, _CMP_GT_OQ), value.row);
  }
};

}  // namespace

const GravityFunctions* gravity_in_quads() {
  return has_quads() ? &GravityLoops<QuadRows, QuadFloats>::functions : nullptr;
}

#else

const GravityFunctions* gravity_in_quads() { return nullptr; }

#endif

}  // namespace animtool
