// Sums of gravity, eight numbers at a time.
#pragma once

#include <algorithm>

#include "base/wide.h"
#include "particles/gravity.h"

namespace animtool {

// Sources between two additions of float32 sums to float64.
constexpr std::size_t GRAVITY_BLOCK = 64;
// Bodies at a smaller squared distance are coincident and do not interact.
constexpr float MIN_SQUARED_DISTANCE = 1e-37f;

template <class On>
struct GravityLoops {
  using F = Wide<float, GRAVITY_WIDTH, On>;
  using D = Wide<double, GRAVITY_WIDTH, On>;

  static void add(const D& a, double* to) { (D::of(to) + a).store(to); }
  static void store_max(const D& a, double* to) { max(D::of(to), a).store(to); }
  static F inverse_root(const F& a) { return 1.0f / sqrt(a); }
  // A value if two bodies are distinct, else 0.
  static F if_distinct(const F& squared, const F& value) {
    return masked(less(MIN_SQUARED_DISTANCE, squared), value);
  }

  // Pair interactions, in either precision.
  template <class T>
  struct Partial {
    T x = 0.0f, y = x, z = x, potential = x, rate = x;

    void pull(const T (&off)[3], const T& mass, const T& target_mass, const T& inverse) {
      const T cubed = inverse * inverse * inverse, pull = mass * cubed;
      x = x + pull * off[0];
      y = y + pull * off[1];
      z = z + pull * off[2];
      potential = potential + mass * inverse;
      rate = max(rate, (mass + target_mass) * cubed);
    }
    void add_to(GravitySums& sums) const {
      add(D(x), sums.x);
      add(D(y), sums.y);
      add(D(z), sums.z);
      add(D(potential), sums.potential);
      store_max(D(rate), sums.rate);
    }
  };

  static void exact(const GravityBodies& from, GravityRun run, double softened,
                    const GravityTargets& to, GravitySums& sums) {
    const D here[3] = {D::of(to.x), D::of(to.y), D::of(to.z)}, target_mass = D::of(to.mass),
            soft = softened;
    Partial<D> part;
    for (std::size_t j = run.begin; j < run.end; ++j) {
      const D off[3] = {D(from.x[j]) - here[0], D(from.y[j]) - here[1], D(from.z[j]) - here[2]};
      const D squared = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
      const D reach = squared + soft;
      const F first = inverse_root(F(reach));
      const D root = D(if_distinct(F(squared), first));
      // Halley's third-order step: from seven digits to full precision.
      const D rest = 1.0 - reach * root * root;
      part.pull(off, from.mass[j], target_mass, root + root * rest * (0.5 + 0.375 * rest));
    }
    part.add_to(sums);
  }

  static void near(const GravityBodies& from, GravityRun run, double softened,
                   const GravityTargets& to, GravitySums& sums) {
    const D here[3] = {D::of(to.x), D::of(to.y), D::of(to.z)};
    const F target_mass = F(D::of(to.mass)), soft = static_cast<float>(softened);
    for (std::size_t first = run.begin; first < run.end; first += GRAVITY_BLOCK) {
      Partial<F> part;
      for (std::size_t j = first; j < std::min(run.end, first + GRAVITY_BLOCK); ++j) {
        const F off[3] = {F(D(from.x[j]) - here[0]), F(D(from.y[j]) - here[1]),
                          F(D(from.z[j]) - here[2])};
        const F squared = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
        const F inverse = inverse_root(squared + soft);
        part.pull(off, static_cast<float>(from.mass[j]), target_mass,
                  if_distinct(squared, inverse));
      }
      part.add_to(sums);
    }
  }

  // Potential 1/s, s² = r² + ε², expanded to second order about the centre of mass.
  static void far(const float* cells, std::size_t count, float softened, const GravityTargets& to,
                  GravitySums& sums) {
    const F here[3] = {F::of(to.from_middle[0]), F::of(to.from_middle[1]),
                       F::of(to.from_middle[2])};
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
        const F outward = 3.0f * fifth;
        part.x = part.x + (pull * x - outward * qx);
        part.y = part.y + (pull * y - outward * qy);
        part.z = part.z + (pull * z - outward * qz);
        part.potential = part.potential + mass + squared * inverse * (1.5f * across - 0.5f * trace);
      }
      part.add_to(sums);
    }
  }

  static constexpr GravityFunctions functions{exact, near, far};
};

}  // namespace animtool
