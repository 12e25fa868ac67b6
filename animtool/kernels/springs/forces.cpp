#include "springs/forces.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include "springs/loops.h"

namespace animtool {

namespace {

// A band has at least this many springs, at most this gap, and a spring for at least half of its
// particles.
constexpr std::size_t MIN_BAND_SPRINGS = 4 * SIMD_WIDTH, MAX_BAND_GAP = 4 * SIMD_WIDTH;

std::size_t lower_end(const Spring& spring) {
  return static_cast<std::size_t>(std::min(spring.i, spring.j));
}

std::size_t index_offset(const Spring& spring) {
  return static_cast<std::size_t>(std::max(spring.i, spring.j)) - lower_end(spring);
}

// Indices of springs, sorted by index offset and then by lower end.
std::vector<std::size_t> order_by_offset(const std::vector<Spring>& springs) {
  std::vector<std::size_t> order(springs.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const auto key = [&](std::size_t s) {
      return std::array{index_offset(springs[s]), lower_end(springs[s]), s};
    };
    return key(a) < key(b);
  });
  return order;
}

}  // namespace

const SpringFunctions& spring_functions() {
  static const SpringFunctions* const quads = springs_in_quads();
  return quads ? *quads : spring_functions_on<Portable>;
}

void SpringForces::Coefficients::add(double rest_length, double spring_stiffness,
                                     double spring_damping) {
  rest_lengths.push_back(rest_length);
  stiffness.push_back(spring_stiffness);
  damping.push_back(spring_damping);
}

SpringForces::SpringForces(const std::vector<Spring>& springs, std::size_t particles)
    : particles_(particles) {
  std::vector<std::size_t> banded_springs;
  std::vector<Band> bands = build_bands(springs, banded_springs);
  // Bands have a cost for each particle, too.
  if (2 * banded_springs.size() < particles) banded_springs.clear();
  if (!banded_springs.empty()) build_chunks(std::move(bands));
  std::vector<bool> is_banded(springs.size());
  for (const std::size_t s : banded_springs) is_banded[s] = true;
  for (std::size_t s = 0; s < springs.size(); ++s) {
    if (is_banded[s]) continue;
    const Spring& spring = springs[s];
    unbanded_ends_.push_back(spring.i);
    unbanded_ends_.push_back(spring.j);
    unbanded_coefficients_.add(spring.rest_length, spring.stiffness, spring.damping);
  }
}

std::vector<SpringForces::Band> SpringForces::build_bands(
    const std::vector<Spring>& springs, std::vector<std::size_t>& banded_springs) const {
  const std::vector<std::size_t> order = order_by_offset(springs);
  std::vector<Band> bands;
  for (std::size_t k = 0; k < order.size();) {
    std::vector<std::size_t> band_springs{order[k]};
    const Spring& first = springs[order[k]];
    for (++k; k < order.size(); ++k) {
      const Spring &last = springs[band_springs.back()], &next = springs[order[k]];
      if (index_offset(next) != index_offset(first) ||
          lower_end(next) > lower_end(last) + MAX_BAND_GAP)
        break;
      // Of several springs between two particles, only one is in a band.
      if (lower_end(next) != lower_end(last)) band_springs.push_back(order[k]);
    }
    const std::size_t length = lower_end(springs[band_springs.back()]) - lower_end(first) + 1;
    if (band_springs.size() < MIN_BAND_SPRINGS || 2 * band_springs.size() < length) continue;
    bands.push_back(build_band(springs, band_springs));
    banded_springs.insert(banded_springs.end(), band_springs.begin(), band_springs.end());
  }
  return bands;
}

SpringForces::Band SpringForces::build_band(const std::vector<Spring>& springs,
                                            const std::vector<std::size_t>& band_springs) {
  const std::size_t first = lower_end(springs[band_springs.front()]) / SIMD_WIDTH * SIMD_WIDTH;
  const std::size_t last = (lower_end(springs[band_springs.back()]) / SIMD_WIDTH + 1) * SIMD_WIDTH;
  Band band{index_offset(springs[band_springs.front()]), first, last, {}};
  for (std::size_t n = first, next = 0; n < last; ++n) {
    if (next == band_springs.size() || lower_end(springs[band_springs[next]]) != n) {
      band.coefficients.add(0, 0, 0);
      continue;
    }
    const Spring& spring = springs[band_springs[next++]];
    band.coefficients.add(spring.rest_length, spring.stiffness, spring.damping);
  }
  return band;
}

void SpringForces::build_chunks(std::vector<Band> bands) {
  std::stable_sort(bands.begin(), bands.end(),
                   [](const Band& a, const Band& b) { return a.first < b.first; });
  const std::size_t height = plane_height(particles_) - SIMD_WIDTH;
  std::vector<const Band*> active_bands;
  for (std::size_t begin = 0, next = 0, end; begin < height; begin = end) {
    std::erase_if(active_bands, [&](const Band* band) { return band->last <= begin; });
    for (; next < bands.size() && bands[next].first == begin; ++next)
      active_bands.push_back(&bands[next]);
    end = std::min(height, begin + MAX_CHUNK_SIZE);
    if (next < bands.size()) end = std::min(end, bands[next].first);
    for (const Band* band : active_bands) end = std::min(end, band->last);
    build_chunk(begin, end, active_bands);
  }
}

void SpringForces::build_chunk(std::size_t begin, std::size_t end, std::vector<const Band*> bands) {
  std::sort(bands.begin(), bands.end(),
            [](const Band* a, const Band* b) { return a->offset < b->offset; });
  chunks_.push_back({begin, end, offsets_.size(), bands.size(), coefficients_.size()});
  max_offset_count_ = std::max(max_offset_count_, bands.size());
  for (const Band* band : bands) offsets_.push_back(band->offset);
  for (std::size_t n = begin; n < end; n += SIMD_WIDTH)
    for (const Band* band : bands) {
      const Coefficients& columns = band->coefficients;
      for (const std::vector<double>* column :
           {&columns.rest_lengths, &columns.stiffness, &columns.damping})
        for (std::size_t l = 0; l < SIMD_WIDTH; ++l)
          coefficients_.push_back((*column)[n - band->first + l]);
    }
}

BandChunks SpringForces::chunks() const {
  return {chunks_.data(), chunks_.size(), offsets_.data(), coefficients_.data()};
}

BandPlanes SpringForces::planes(ForceBuffers& buffers) const {
  return {plane_height(particles_), buffers.x.data(), buffers.v.data(), buffers.f.data(),
          buffers.spring_forces.data()};
}

void SpringForces::allocate(ForceBuffers& buffers) const {
  const std::size_t size = 3 * plane_height(particles_);
  buffers.x.resize(size);
  buffers.v.resize(size);
  buffers.f.assign(size, 0.0);
  buffers.spring_forces.resize(3 * max_offset_count_ * FORCE_COLUMN);
}

void SpringForces::read(const double* rows, std::vector<double>& columns) const {
  spring_functions().to_planes(rows, particles_, plane_height(particles_), columns.data());
}

void SpringForces::write(const std::vector<double>& columns, double* rows) const {
  spring_functions().to_rows(columns.data(), particles_, plane_height(particles_), rows);
}

void SpringForces::compute(const double* x, const double* v, ForceBuffers& buffers,
                           double* forces) const {
  if (!has_bands()) {
    std::fill_n(forces, PARTICLE_STRIDE * particles_, 0.0);
  } else {
    allocate(buffers);
    read(x, buffers.x);
    read(v, buffers.v);
    spring_functions().add_plane_forces(chunks(), planes(buffers));
    write(buffers.f, forces);
  }
  add_unbanded(x, v, forces);
}

void SpringForces::add_unbanded(const double* x, const double* v, double* forces) const {
  const SpringColumns columns{unbanded_ends_.data(), unbanded_coefficients_.rest_lengths.data(),
                              unbanded_coefficients_.stiffness.data(),
                              unbanded_coefficients_.damping.data()};
  spring_functions().add_forces(columns, unbanded_coefficients_.rest_lengths.size(), x, v, forces);
}

void SpringForces::step(const PlaneSteps& steps, ForceBuffers& buffers) const {
  spring_functions().step_planes(chunks(), steps, planes(buffers));
}

}  // namespace animtool
