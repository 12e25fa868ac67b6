// Particles four or eight at a time, for processors that have registers of four doubles.
#include "base/quads.h"
#include "particles/gravity_lanes.h"
#include "particles/molecules_lanes.h"
#include "particles/neighbours.h"

namespace animtool {

const GravityFunctions* gravity_in_quads() {
  return has_quads() ? &GravityKernels<Quads>::functions : nullptr;
}

MoleculeFunction molecules_in_quads() {
  return has_quads() ? MoleculeKernels<Quads>::add_forces : nullptr;
}

#ifdef ANIMTOOL_QUADS

namespace {

// Indices that pack the selected values of four to the front.
alignas(16) constexpr std::int32_t PACKED_INDICES[16][4] = {
    {0, 0, 0, 0}, {0, 0, 0, 0}, {1, 0, 0, 0}, {0, 1, 0, 0}, {2, 0, 0, 0}, {0, 2, 0, 0},
    {1, 2, 0, 0}, {0, 1, 2, 0}, {3, 0, 0, 0}, {0, 3, 0, 0}, {1, 3, 0, 0}, {0, 1, 3, 0},
    {2, 3, 0, 0}, {0, 2, 3, 0}, {1, 2, 3, 0}, {0, 1, 2, 3}};
constexpr std::int32_t SELECTED_COUNTS[16] = {0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4};

std::int32_t* neighbours_by_fours(const GridPoints& points, const GridRun* run, const GridRun* last,
                                  const double* point, std::int32_t* next) {
  const FourVec<Quads> position = FourVec<Quads>::broadcast(point);
  const Four<Quads> squared_radius = points.squared_radius;
  for (; run < last; ++run)
    for (std::size_t i = run->begin; i < run->end; i += 4) {
      const FourVec<Quads> neighbour{Four<Quads>::load(points.x + i),
                                     Four<Quads>::load(points.y + i),
                                     Four<Quads>::load(points.z + i)};
      const FourVec<Quads> offset = neighbour - position;
      unsigned selected_bits = static_cast<unsigned>(_mm256_movemask_pd(
          _mm256_cmp_pd(dot(offset, offset).row, squared_radius.row, _CMP_LE_OQ)));
      if (run->end - i < 4) selected_bits &= (1u << (run->end - i)) - 1;
      const __m128i matches = _mm_add_epi32(
          _mm_load_si128(reinterpret_cast<const __m128i*>(PACKED_INDICES[selected_bits])),
          _mm_set1_epi32(static_cast<std::int32_t>(i)));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(next), matches);
      next += SELECTED_COUNTS[selected_bits];
    }
  return next;
}

}  // namespace

NeighbourFunction neighbours_in_quads() { return has_quads() ? neighbours_by_fours : nullptr; }

#else

NeighbourFunction neighbours_in_quads() { return nullptr; }

#endif

}  // namespace animtool
