// Distances four at a time for processors with registers of four doubles; the build says where
// the compiler may use them, and the processor is asked before it runs.
#include "base/quads.h"
#include "particles/neighbours.h"

namespace animtool {

#ifdef ANIMTOOL_QUADS

namespace {

// Which of four are, side by side from the first.
alignas(16) constexpr std::int32_t PACKED[16][4] = {
    {0, 0, 0, 0}, {0, 0, 0, 0}, {1, 0, 0, 0}, {0, 1, 0, 0}, {2, 0, 0, 0}, {0, 2, 0, 0},
    {1, 2, 0, 0}, {0, 1, 2, 0}, {3, 0, 0, 0}, {0, 3, 0, 0}, {1, 3, 0, 0}, {0, 1, 3, 0},
    {2, 3, 0, 0}, {0, 2, 3, 0}, {1, 2, 3, 0}, {0, 1, 2, 3}};
constexpr std::int32_t COUNTS[16] = {0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4};

std::int32_t* near_four(const NearPlaces& places, const NearRun* run, const NearRun* last,
                        const double* at, std::int32_t* next) {
  const __m256d here[3] = {_mm256_set1_pd(at[0]), _mm256_set1_pd(at[1]), _mm256_set1_pd(at[2])};
  const __m256d most = _mm256_set1_pd(places.most);
  for (; run < last; ++run)
    for (std::size_t i = run->begin; i < run->end; i += 4) {
      const __m256d x = _mm256_sub_pd(_mm256_loadu_pd(places.x + i), here[0]);
      const __m256d y = _mm256_sub_pd(_mm256_loadu_pd(places.y + i), here[1]);
      const __m256d z = _mm256_sub_pd(_mm256_loadu_pd(places.z + i), here[2]);
      const __m256d squares = _mm256_add_pd(
          _mm256_add_pd(_mm256_mul_pd(x, x), _mm256_mul_pd(y, y)), _mm256_mul_pd(z, z));
      unsigned bits =
          static_cast<unsigned>(_mm256_movemask_pd(_mm256_cmp_pd(squares, most, _CMP_LE_OQ)));
      if (run->end - i < 4) bits &= (1u << (run->end - i)) - 1;
      const __m128i found =
          _mm_add_epi32(_mm_load_si128(reinterpret_cast<const __m128i*>(PACKED[bits])),
                        _mm_set1_epi32(static_cast<std::int32_t>(i)));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(next), found);
      next += COUNTS[bits];
    }
  return next;
}

}  // namespace

NearFunction near_in_quads() { return has_quads() ? near_four : nullptr; }

#else

NearFunction near_in_quads() { return nullptr; }

#endif

}  // namespace animtool
