// Spatial hash of points.
#include "springs/grid.h"

namespace animtool {

void PointGrid::build(const double* rows, std::size_t count, double cell_size) {
  count_ = count;
  std::size_t size = 16;
  while (size < 2 * count) size *= 2;
  mask_ = size - 1;
  inverse_cell_ = 1 / cell_size;
  for (std::size_t k = 0; k < 3; ++k) low_[k] = count ? rows[k] : 0;
  for (std::size_t n = 0; n < count; ++n)
    for (std::size_t k = 0; k < 3; ++k) low_[k] = std::min(low_[k], rows[PARTICLE_STRIDE * n + k]);
  std::vector<std::uint64_t> keys(count);
  starts_.assign(size + 1, 0);
  for (std::size_t n = 0; n < count; ++n) {
    std::int64_t cell[3];
    for (std::size_t k = 0; k < 3; ++k) cell[k] = cell_of(rows[PARTICLE_STRIDE * n + k], k);
    keys[n] = key(cell);
    ++starts_[bucket(keys[n]) + 1];
  }
  for (std::size_t b = 0; b < size; ++b) starts_[b + 1] += starts_[b];
  keys_.resize(count);
  points_.resize(count);
  positions_.resize(PARTICLE_STRIDE * count);
  std::vector<std::uint32_t> next(starts_.begin(), starts_.end() - 1);
  for (std::size_t n = 0; n < count; ++n) {
    const std::size_t slot = next[bucket(keys[n])]++;
    keys_[slot] = keys[n];
    points_[slot] = static_cast<std::int32_t>(n);
    std::copy_n(rows + PARTICLE_STRIDE * n, PARTICLE_STRIDE,
                positions_.data() + PARTICLE_STRIDE * slot);
  }
}

}  // namespace animtool
