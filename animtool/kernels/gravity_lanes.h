// Sums of gravity, whichever way a processor holds eight numbers.
//
// Nothing here is shared between source files, which are built for other processors: W, rows of
// four doubles, is another type in each, and so is L, eight floats.
#pragma once

#include <algorithm>

#include "gravity.h"
#include "rows.h"
#include "wide.h"

namespace animtool {

// Sources between two additions of float32 to float64.
constexpr std::size_t GRAVITY_BLOCK = 64;
// Bodies whose squared distance is below do not act on each other: they are at one place.
constexpr float GRAVITY_APART = 1e-37f;

// Eight doubles, as two rows.
template <class W>
struct GravityDoubles {
  Wide<W> low, high;

  GravityDoubles() = default;
  GravityDoubles(Wide<W> low, Wide<W> high) : low(low), high(high) {}
  GravityDoubles(double value) : low(value), high(value) {}
  explicit GravityDoubles(const double* from)
      : low(Wide<W>::of(from)), high(Wide<W>::of(from + WIDE)) {}
  void store(double* to) const { low.store(to), high.store(to + WIDE); }

  using D = GravityDoubles;
  friend D operator+(const D& a, const D& b) { return {a.low + b.low, a.high + b.high}; }
  friend D operator-(const D& a, const D& b) { return {a.low - b.low, a.high - b.high}; }
  friend D operator*(const D& a, const D& b) { return {a.low * b.low, a.high * b.high}; }
  friend D most(const D& a, const D& b) { return {most(a.low, b.low), most(a.high, b.high)}; }
};

template <class W, class L>
struct GravityLoops {
  using F = L;
  using D = GravityDoubles<W>;

  static void add(const D& a, double* to) { (D(to) + a).store(to); }
  static void raise(const D& a, double* to) { most(D(to), a).store(to); }
  static D widen(const F& a) {
    D wide;
    a.widen(wide.low.row, wide.high.row);
    return wide;
  }
  static F narrow(const D& a) { return F::narrow(a.low.row, a.high.row); }

  struct Partial {
    F x = 0.0f, y = x, z = x, potential = x, rate = x;

    void into(GravitySums& sums) const {
      add(widen(x), sums.x);
      add(widen(y), sums.y);
      add(widen(z), sums.z);
      add(widen(potential), sums.potential);
      raise(widen(rate), sums.rate);
    }
  };

  static void exact(const GravityBodies& from, GravityRun run, double softened,
                    const GravityTargets& to, GravitySums& sums) {
    const D here[3] = {D(to.x), D(to.y), D(to.z)};
    const D own = D(to.mass), soft = softened;
    D ax = 0.0, ay = ax, az = ax, potential = ax, rate = ax;
    for (std::size_t j = run.begin; j < run.end; ++j) {
      const D x = D(from.x[j]) - here[0], y = D(from.y[j]) - here[1];
      const D z = D(from.z[j]) - here[2], mass = from.mass[j];
      const D squared = x * x + y * y + z * z, reach = squared + soft;
      const F first = inverse_root(narrow(reach));
      const D root = widen(where_above(narrow(squared), GRAVITY_APART, first));
      // The third-order step of Halley: from seven digits to all.
      const D off = 1.0 - reach * root * root;
      const D inverse = root + root * off * (0.5 + 0.375 * off);
      const D cubed = inverse * inverse * inverse, pull = mass * cubed;
      ax = ax + pull * x;
      ay = ay + pull * y;
      az = az + pull * z;
      potential = potential + mass * inverse;
      rate = most(rate, (mass + own) * cubed);
    }
    add(ax, sums.x);
    add(ay, sums.y);
    add(az, sums.z);
    add(potential, sums.potential);
    raise(rate, sums.rate);
  }

  static void near(const GravityBodies& from, GravityRun run, double softened,
                   const GravityTargets& to, GravitySums& sums) {
    const D here[3] = {D(to.x), D(to.y), D(to.z)};
    const F own = narrow(D(to.mass)), soft = static_cast<float>(softened);
    for (std::size_t first = run.begin; first < run.end; first += GRAVITY_BLOCK) {
      Partial part;
      for (std::size_t j = first; j < std::min(run.end, first + GRAVITY_BLOCK); ++j) {
        const F x = narrow(D(from.x[j]) - here[0]);
        const F y = narrow(D(from.y[j]) - here[1]);
        const F z = narrow(D(from.z[j]) - here[2]);
        const F mass = static_cast<float>(from.mass[j]);
        const F squared = x * x + y * y + z * z;
        const F inverse =
            where_above(squared, GRAVITY_APART, inverse_root(squared + soft));
        const F cubed = inverse * inverse * inverse, pull = mass * cubed;
        part.x = part.x + pull * x;
        part.y = part.y + pull * y;
        part.z = part.z + pull * z;
        part.potential = part.potential + mass * inverse;
        part.rate = most(part.rate, (mass + own) * cubed);
      }
      part.into(sums);
    }
  }

  // Of the potential 1/s, s² = r² + ε², by Taylor to second order about the centre of mass.
  static void far(const float* cells, std::size_t count, float softened,
                  const GravityTargets& to, GravitySums& sums) {
    const F here[3] = {F(to.from_middle[0]), F(to.from_middle[1]),
                       F(to.from_middle[2])};
    const F soft = softened;
    for (std::size_t first = 0; first < count; first += GRAVITY_BLOCK) {
      Partial part;
      for (std::size_t j = first; j < std::min(count, first + GRAVITY_BLOCK); ++j) {
        const float* cell = cells + GRAVITY_FAR * j;
        const F x = F(cell[0]) - here[0], y = F(cell[1]) - here[1];
        const F z = F(cell[2]) - here[2];
        const F xx = cell[4], xy = cell[5], xz = cell[6];
        const F yy = cell[7], yz = cell[8], zz = cell[9];
        const F inverse = inverse_root(x * x + y * y + z * z + soft);
        const F squared = inverse * inverse, mass = F(cell[3]) * inverse;
        const F qx = xx * x + xy * y + xz * z, qy = xy * x + yy * y + yz * z;
        const F qz = xz * x + yz * y + zz * z;
        const F fifth = squared * squared * inverse;
        const F across = (qx * x + qy * y + qz * z) * squared, trace = xx + yy + zz;
        const F pull = mass * squared + fifth * (7.5f * across - 1.5f * trace);
        const F aside = 3.0f * fifth;
        part.x = part.x + (pull * x - aside * qx);
        part.y = part.y + (pull * y - aside * qy);
        part.z = part.z + (pull * z - aside * qz);
        part.potential = part.potential + mass +
                         squared * inverse * (1.5f * across - 0.5f * trace);
      }
      part.into(sums);
    }
  }

  static constexpr GravityFunctions functions{exact, near, far};
};

}  // namespace animtool
