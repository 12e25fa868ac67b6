// Sums of gravity, whichever way a processor holds eight numbers.
//
// Nothing here is shared between source files, which are built for other processors: L is
// another type in each.
#pragma once

#include <algorithm>

#include "gravity.h"

namespace animtool {

// Sources between two additions of float32 to float64.
constexpr std::size_t GRAVITY_BLOCK = 64;
// Bodies whose squared distance is below do not act on each other: they are at one place.
constexpr float GRAVITY_APART = 1e-37f;

template <class L>
struct GravityLoops {
  using F = typename L::F;
  using D = typename L::D;

  struct Partial {
    F x = L::spread(0.0f), y = x, z = x, potential = x, rate = x;

    void into(GravitySums& sums) const {
      L::add(L::widen(x), sums.x);
      L::add(L::widen(y), sums.y);
      L::add(L::widen(z), sums.z);
      L::add(L::widen(potential), sums.potential);
      L::raise(L::widen(rate), sums.rate);
    }
  };

  static void exact(const GravityBodies& from, GravityRun run, double softened,
                    const GravityTargets& to, GravitySums& sums) {
    const D here[3] = {L::load(to.x), L::load(to.y), L::load(to.z)};
    const D own = L::load(to.mass), soft = L::spread(softened);
    const D one = L::spread(1.0), half = L::spread(0.5), more = L::spread(0.375);
    D ax = L::spread(0.0), ay = ax, az = ax, potential = ax, rate = ax;
    for (std::size_t j = run.begin; j < run.end; ++j) {
      const D x = L::spread(from.x[j]) - here[0], y = L::spread(from.y[j]) - here[1];
      const D z = L::spread(from.z[j]) - here[2], mass = L::spread(from.mass[j]);
      const D squared = x * x + y * y + z * z, reach = squared + soft;
      const F first = L::inverse_root(L::narrow(reach));
      const D root = L::widen(L::where_above(L::narrow(squared), GRAVITY_APART, first));
      // The third-order step of Halley: from seven digits to all.
      const D off = one - reach * root * root;
      const D inverse = root + root * off * (half + more * off);
      const D cubed = inverse * inverse * inverse, pull = mass * cubed;
      ax = ax + pull * x;
      ay = ay + pull * y;
      az = az + pull * z;
      potential = potential + mass * inverse;
      rate = L::most(rate, (mass + own) * cubed);
    }
    L::add(ax, sums.x);
    L::add(ay, sums.y);
    L::add(az, sums.z);
    L::add(potential, sums.potential);
    L::raise(rate, sums.rate);
  }

  static void near(const GravityBodies& from, GravityRun run, double softened,
                   const GravityTargets& to, GravitySums& sums) {
    const D here[3] = {L::load(to.x), L::load(to.y), L::load(to.z)};
    const F own = L::narrow(L::load(to.mass)), soft = L::spread(static_cast<float>(softened));
    for (std::size_t first = run.begin; first < run.end; first += GRAVITY_BLOCK) {
      Partial part;
      for (std::size_t j = first; j < std::min(run.end, first + GRAVITY_BLOCK); ++j) {
        const F x = L::narrow(L::spread(from.x[j]) - here[0]);
        const F y = L::narrow(L::spread(from.y[j]) - here[1]);
        const F z = L::narrow(L::spread(from.z[j]) - here[2]);
        const F mass = L::spread(static_cast<float>(from.mass[j]));
        const F squared = x * x + y * y + z * z;
        const F inverse =
            L::where_above(squared, GRAVITY_APART, L::inverse_root(squared + soft));
        const F cubed = inverse * inverse * inverse, pull = mass * cubed;
        part.x = part.x + pull * x;
        part.y = part.y + pull * y;
        part.z = part.z + pull * z;
        part.potential = part.potential + mass * inverse;
        part.rate = L::most(part.rate, (mass + own) * cubed);
      }
      part.into(sums);
    }
  }

  // Of the potential 1/s, s² = r² + ε², by Taylor to second order about the centre of mass.
  static void far(const float* cells, std::size_t count, float softened,
                  const GravityTargets& to, GravitySums& sums) {
    const F here[3] = {L::load(to.from_middle[0]), L::load(to.from_middle[1]),
                       L::load(to.from_middle[2])};
    const F soft = L::spread(softened), wide = L::spread(7.5f), narrow = L::spread(1.5f);
    const F third = L::spread(3.0f), half = L::spread(0.5f);
    for (std::size_t first = 0; first < count; first += GRAVITY_BLOCK) {
      Partial part;
      for (std::size_t j = first; j < std::min(count, first + GRAVITY_BLOCK); ++j) {
        const float* cell = cells + GRAVITY_FAR * j;
        const F x = L::spread(cell[0]) - here[0], y = L::spread(cell[1]) - here[1];
        const F z = L::spread(cell[2]) - here[2];
        const F xx = L::spread(cell[4]), xy = L::spread(cell[5]), xz = L::spread(cell[6]);
        const F yy = L::spread(cell[7]), yz = L::spread(cell[8]), zz = L::spread(cell[9]);
        const F inverse = L::inverse_root(x * x + y * y + z * z + soft);
        const F squared = inverse * inverse, mass = L::spread(cell[3]) * inverse;
        const F qx = xx * x + xy * y + xz * z, qy = xy * x + yy * y + yz * z;
        const F qz = xz * x + yz * y + zz * z;
        const F fifth = squared * squared * inverse;
        const F across = (qx * x + qy * y + qz * z) * squared, trace = xx + yy + zz;
        const F pull = mass * squared + fifth * (wide * across - narrow * trace);
        const F aside = third * fifth;
        part.x = part.x + (pull * x - aside * qx);
        part.y = part.y + (pull * y - aside * qy);
        part.z = part.z + (pull * z - aside * qz);
        part.potential = part.potential + mass +
                         squared * inverse * (narrow * across - half * trace);
      }
      part.into(sums);
    }
  }

  static constexpr GravityFunctions functions{exact, near, far};
};

}  // namespace animtool
