#include "springs_pulls.h"

#include <algorithm>
#include <array>
#include <numeric>

namespace animtool {

namespace {

// A band has as many springs, at least half of its places, and no gap of more places.
constexpr std::size_t LEAST = 4 * WIDE, GAP = 4 * WIDE;

std::size_t low(const Spring& spring) {
  return static_cast<std::size_t>(std::min(spring.i, spring.j));
}

std::size_t offset(const Spring& spring) {
  return static_cast<std::size_t>(std::max(spring.i, spring.j)) - low(spring);
}

// Numbers of springs, by their offsets and then by where they begin.
std::vector<std::size_t> by_offset(const std::vector<Spring>& springs) {
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

void SpringPulls::Numbers::add(double length, double stiff, double damps) {
  rest.push_back(length);
  stiffness.push_back(stiff);
  damping.push_back(damps);
}

SpringPulls::SpringPulls(const std::vector<Spring>& springs, std::size_t particles)
    : particles_(particles) {
  std::vector<bool> laid(springs.size());
  std::vector<std::size_t> banded = lay_bands(springs);
  // What bands cost besides is by particle.
  if (2 * banded.size() < particles) {
    bands_.clear();
    banded_ = {};
    banded.clear();
  }
  for (const std::size_t s : banded) laid[s] = true;
  for (std::size_t s = 0; s < springs.size(); ++s) {
    if (laid[s]) continue;
    const Spring& spring = springs[s];
    loose_ends_.push_back(spring.i);
    loose_ends_.push_back(spring.j);
    loose_.add(spring.rest, spring.stiffness, spring.damping);
  }
}

std::vector<std::size_t> SpringPulls::lay_bands(const std::vector<Spring>& springs) {
  const std::vector<std::size_t> order = by_offset(springs);
  std::vector<std::size_t> banded;
  for (std::size_t k = 0; k < order.size();) {
    std::vector<std::size_t> chosen{order[k]};
    const Spring& first = springs[order[k]];
    for (++k; k < order.size(); ++k) {
      const Spring &last = springs[chosen.back()], &next = springs[order[k]];
      if (offset(next) != offset(first) || low(next) > low(last) + GAP) break;
      // Of several springs between two particles one is in a band.
      if (low(next) != low(last)) chosen.push_back(order[k]);
    }
    const std::size_t places = low(springs[chosen.back()]) - low(first) + 1;
    if (chosen.size() < LEAST || 2 * chosen.size() < places) continue;
    lay_band(springs, chosen.data(), chosen.size());
    banded.insert(banded.end(), chosen.begin(), chosen.end());
  }
  return banded;
}

void SpringPulls::lay_band(const std::vector<Spring>& springs, const std::size_t* chosen,
                           std::size_t count) {
  const std::size_t first = low(springs[chosen[0]]) / WIDE * WIDE;
  const std::size_t last = (low(springs[chosen[count - 1]]) / WIDE + 1) * WIDE;
  bands_.push_back({offset(springs[chosen[0]]), first, last, banded_.rest.size()});
  for (std::size_t n = first, c = 0; n < last; ++n) {
    if (c == count || low(springs[chosen[c]]) != n) {
      banded_.add(0, 0, 0);
      continue;
    }
    const Spring& spring = springs[chosen[c++]];
    banded_.add(spring.rest, spring.stiffness, spring.damping);
  }
}

void SpringPulls::set(const double* x, const double* v, PullRoom& room,
                      double* forces) const {
  static const SetBandPulls quad_bands = set_band_pulls_in_quads();
  static const AddPulls quads = add_pulls_in_quads();
  if (bands_.empty()) {
    std::fill_n(forces, ROW * particles_, 0.0);
  } else {
    const std::size_t height = plane_height(particles_);
    for (std::vector<double>* plane : {&room.x, &room.v, &room.f}) plane->resize(3 * height);
    const BandNumbers numbers{bands_.data(), bands_.size(), banded_.rest.data(),
                              banded_.stiffness.data(), banded_.damping.data()};
    const BandPlanes planes{height, room.x.data(), room.v.data(), room.f.data()};
    (quad_bands ? quad_bands : set_band_pulls<PlainRows>)(numbers, particles_, x, v, planes,
                                                          forces);
  }
  const SpringColumns columns{loose_ends_.data(), loose_.rest.data(), loose_.stiffness.data(),
                              loose_.damping.data()};
  (quads ? quads : add_pulls<PlainRows>)(columns, loose_.rest.size(), x, v, forces);
}

}  // namespace animtool
