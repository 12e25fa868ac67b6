// Sums of gravity, whichever way a processor holds eight numbers.
//
// Nothing here is shared between source files, which are built for other processors: W, rows of
// four doubles, is another type in each, and so is L, eight floats.
#pragma once

#include <algorithm>

#include "base/rows.h"
#include "base/wide.h"
#include "particles/gravity.h"

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

  static const D& widen(const D& a) { return a; }

  // What pairs do, in numbers of either kind.
  template <class T>
  struct Partial {
    T x = 0.0f, y = x, z = x, potential = x, rate = x;

    void pull(const T (&off)[3], const T& mass, const T& own, const T& inverse) {
      const T cubed = inverse * inverse * inverse, pull = mass * cubed;
      x = x + pull * off[0];
      y = y + pull * off[1];
      z = z + pull * off[2];
      potential = potential + mass * inverse;
      rate = most(rate, (mass + own) * cubed);
    }
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
    const D here[3] = {D(to.x), D(to.y), D(to.z)}, own = D(to.mass), soft = softened;
    Partial<D> part;
    for (std::size_t j = run.begin; j < run.end; ++j) {
      const D off[3] = {D(from.x[j]) - here[0], D(from.y[j]) - here[1], D(from.z[j]) - here[2]};
      const D squared = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
      const D reach = squared + soft;
      const F first = inverse_root(narrow(reach));
      const D root = widen(where_above(narrow(squared), GRAVITY_APART, first));
      // The third-order step of Halley: from seven digits to all.
      const D rest = 1.0 - reach * root * root;
      part.pull(off, from.mass[j], own, root + root * rest * (0.5 + 0.375 * rest));
    }
    part.into(sums);
  }

  static void near(const GravityBodies& from, GravityRun run, double softened,
                   const GravityTargets& to, GravitySums& sums) {
    const D here[3] = {D(to.x), D(to.y), D(to.z)};
    const F own = narrow(D(to.mass)), soft = static_cast<float>(softened);
    for (std::size_t first = run.begin; first < run.end; first += GRAVITY_BLOCK) {
      Partial<F> part;
      for (std::size_t j = first; j < std::min(run.end, first + GRAVITY_BLOCK); ++j) {
        const F off[3] = {narrow(D(from.x[j]) - here[0]), narrow(D(from.y[j]) - here[1]),
                          narrow(D(from.z[j]) - here[2])};
        const F squared = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
        const F inverse = inverse_root(squared + soft);
        part.pull(off, static_cast<float>(from.mass[j]), own,
                  where_above(squared, GRAVITY_APART, inverse));
      }
      part.into(sums);
    }
  }

  // Of the potential 1/s, s² = r² + ε², by Taylor to second order about the centre of mass.
  static void far(const float* cells, std::size_t count, float softened,
                  const GravityTargets& to, GravitySums& sums) {
    const F here[3] = {F(to.from_middle[0]), F(to.from_middle[1]), F(to.from_middle[2])};
    const F soft = softened;
    for (std::size_t first = 0; first < count; first += GRAVITY_BLOCK) {
      Partial<F> part;
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
