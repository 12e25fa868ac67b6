// Forces between molecules for processors with registers of four doubles; the build says where
// the compiler may use them, and the processor is asked before it runs.
#include "molecules_lanes.h"
#include "processor.h"

#if defined(__AVX2__) && defined(__GNUC__)
#define ANIMTOOL_QUADS
#include <immintrin.h>
#endif

namespace animtool {

#ifdef ANIMTOOL_QUADS

namespace {

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

}  // namespace

MoleculeFunction molecules_in_quads() {
  return has_quads() ? MoleculeLoops<QuadLanes>::run : nullptr;
}

#else

MoleculeFunction molecules_in_quads() { return nullptr; }

#endif

}  // namespace animtool
