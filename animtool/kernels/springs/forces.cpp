#include "springs/forces.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include "springs/loops.h"

namespace animtool {

namespace {

// A band has at least this many springs, one for at least half of its particles, and no larger gap.
constexpr std::size_t MIN_SPRINGS = 4 * WIDE, MAX_GAP = 4 * WIDE;

std::size_t low(const Spring& spring) {
  return static_cast<std::size_t>(std::min(spring.i, spring.j));
}

std::size_t offset(const Spring& spring) {
  return static_cast<std::size_t>(std::max(spring.i, spring.j)) - low(spring);
}

// Indices of springs, sorted by offset and then by first particle.
std::vector<std::size_t> order_by_offset(const std::vector<Spring>& springs) {
  std::vector<std::size_t> order(springs.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const auto key = [&](std::size_t s) {
      return std::array{offset(springs[s]), low(springs[s]), s};
    };
    return key(a) < key(b);
  });
  return order;
}

}  // namespace

const SpringLoops& spring_loops() {
  static const SpringLoops* const quads = springs_in_quads();
  return quads ? *quads : spring_loops_on<Plain>;
}

void SpringForces::Numbers::add(double length, double stiff, double damps) {
  rest.push_back(length);
  stiffness.push_back(stiff);
  damping.push_back(damps);
}

SpringForces::SpringForces(const std::vector<Spring>& springs, std::size_t particles)
    : particles_(particles) {
  std::vector<std::size_t> banded;
  std::vector<Band> bands = build_bands(springs, banded);
  // Bands have a cost for each particle, too.
  if (2 * banded.size() < particles) banded.clear();
  if (!banded.empty()) build_pieces(std::move(bands));
  std::vector<bool> is_banded(springs.size());
  for (const std::size_t s : banded) is_banded[s] = true;
  for (std::size_t s = 0; s < springs.size(); ++s) {
    if (is_banded[s]) continue;
    const Spring& spring = springs[s];
    unbanded_ends_.push_back(spring.i);
    unbanded_ends_.push_back(spring.j);
    unbanded_.add(spring.rest, spring.stiffness, spring.damping);
  }
}

std::vector<SpringForces::Band> SpringForces::build_bands(const std::vector<Spring>& springs,
                                                          std::vector<std::size_t>& banded) const {
  const std::vector<std::size_t> order = order_by_offset(springs);
  std::vector<Band> bands;
  for (std::size_t k = 0; k < order.size();) {
    std::vector<std::size_t> chosen{order[k]};
    const Spring& first = springs[order[k]];
    for (++k; k < order.size(); ++k) {
      const Spring &last = springs[chosen.back()], &next = springs[order[k]];
      if (offset(next) != offset(first) || low(next) > low(last) + MAX_GAP) break;
      // Of several springs between two particles, only one is in a band.
      if (low(next) != low(last)) chosen.push_back(order[k]);
    }
    const std::size_t locations = low(springs[chosen.back()]) - low(first) + 1;
    if (chosen.size() < MIN_SPRINGS || 2 * chosen.size() < locations) continue;
    bands.push_back(band_of(springs, chosen));
    banded.insert(banded.end(), chosen.begin(), chosen.end());
  }
  return bands;
}

SpringForces::Band SpringForces::band_of(const std::vector<Spring>& springs,
                                         const std::vector<std::size_t>& chosen) {
  const std::size_t first = low(springs[chosen.front()]) / WIDE * WIDE;
  const std::size_t last = (low(springs[chosen.back()]) / WIDE + 1) * WIDE;
  Band band{offset(springs[chosen.front()]), first, last, {}};
  for (std::size_t n = first, c = 0; n < last; ++n) {
    if (c == chosen.size() || low(springs[chosen[c]]) != n) {
      band.numbers.add(0, 0, 0);
      continue;
    }
    const Spring& spring = springs[chosen[c++]];
    band.numbers.add(spring.rest, spring.stiffness, spring.damping);
  }
  return band;
}

void SpringForces::build_pieces(std::vector<Band> bands) {
  std::stable_sort(bands.begin(), bands.end(),
                   [](const Band& a, const Band& b) { return a.first < b.first; });
  const std::size_t full = plane_height(particles_) - WIDE;
  std::vector<const Band*> active;
  for (std::size_t begin = 0, next = 0, end; begin < full; begin = end) {
    std::erase_if(active, [&](const Band* band) { return band->last <= begin; });
    for (; next < bands.size() && bands[next].first == begin; ++next)
      active.push_back(&bands[next]);
    end = std::min(full, begin + BAND_PIECE);
    if (next < bands.size()) end = std::min(end, bands[next].first);
    for (const Band* band : active) end = std::min(end, band->last);
    build_piece(begin, end, active);
  }
}

void SpringForces::build_piece(std::size_t begin, std::size_t end, std::vector<const Band*> bands) {
  std::sort(bands.begin(), bands.end(),
            [](const Band* a, const Band* b) { return a->offset < b->offset; });
  pieces_.push_back({begin, end, offsets_.size(), bands.size(), numbers_.size()});
  max_offsets_ = std::max(max_offsets_, bands.size());
  for (const Band* band : bands) offsets_.push_back(band->offset);
  for (std::size_t n = begin; n < end; n += WIDE)
    for (const Band* band : bands) {
      const Numbers& padded = band->numbers;
      for (const std::vector<double>* column : {&padded.rest, &padded.stiffness, &padded.damping})
        for (std::size_t l = 0; l < WIDE; ++l) numbers_.push_back((*column)[n - band->first + l]);
    }
}

BandPieces SpringForces::pieces() const {
  return {pieces_.data(), pieces_.size(), offsets_.data(), numbers_.data()};
}

BandPlanes SpringForces::planes(ForceBuffers& buffers) const {
  return {plane_height(particles_), buffers.x.data(), buffers.v.data(), buffers.f.data(),
          buffers.stored.data()};
}

void SpringForces::allocate(ForceBuffers& buffers) const {
  const std::size_t size = 3 * plane_height(particles_);
  buffers.x.resize(size);
  buffers.v.resize(size);
  buffers.f.assign(size, 0.0);
  buffers.stored.resize(3 * max_offsets_ * STORED);
}

void SpringForces::read(const double* rows, std::vector<double>& columns) const {
  spring_loops().to_planes(rows, particles_, plane_height(particles_), columns.data());
}

void SpringForces::write(const std::vector<double>& columns, double* rows) const {
  spring_loops().to_rows(columns.data(), particles_, plane_height(particles_), rows);
}

void SpringForces::set(const double* x, const double* v, ForceBuffers& buffers,
                       double* forces) const {
  if (!has_bands()) {
    std::fill_n(forces, ROW * particles_, 0.0);
  } else {
    allocate(buffers);
    read(x, buffers.x);
    read(v, buffers.v);
    spring_loops().pull_planes(pieces(), planes(buffers));
    write(buffers.f, forces);
  }
  add_unbanded(x, v, forces);
}

void SpringForces::add_unbanded(const double* x, const double* v, double* forces) const {
  const SpringColumns columns{unbanded_ends_.data(), unbanded_.rest.data(),
                              unbanded_.stiffness.data(), unbanded_.damping.data()};
  spring_loops().add_forces(columns, unbanded_.rest.size(), x, v, forces);
}

void SpringForces::step(const PlaneSteps& steps, ForceBuffers& buffers) const {
  spring_loops().step_planes(pieces(), steps, planes(buffers));
}

}  // namespace animtool
