// Particles of a fluid: how dense it is at each, and steps that keep it from being denser
// than at rest (M. Macklin, M. Müller, "Position based fluids", 2013; M. Macklin et al., "Small
// steps in physics simulation", 2019).
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "colliders/colliders.h"

namespace animtool::fluid {

using collide::Vec;

// Radius that particles see each other in, in spacings.
constexpr double REACH = 2.0;
// Positions beyond the radius that lists of neighbours hold, over the radius.
constexpr double SKIN = 0.15;
// How much further off walls and bodies count than they are, in spacings: measured by how much
// fluid is displaced.
constexpr double LOOSE = 0.02, LOOSE_AROUND = 0.12;
// Share of a step to the place where nothing is dense that is taken, of a lattice: all
// particles step at once, and steps of more than two thirds grow where every second one is
// dense. All are as stiff, so that pressure has a potential: else it drives fluid round and
// round for ever. Particles that are much more crowded than a lattice are less stiff, by this
// share of the squares of their slopes.
constexpr double RELAXED = 0.45, STEEP = 0.6;
// Pairs that part or close in by less than this over the speed of sound are noise, which
// fades by CALM each time that sound goes one spacing; faster ones, hardly. That many parts
// are taken together.
constexpr double NOISE = 1.6e-3, CALM = 0.1;
// What that is as a viscosity, over the speed of sound and the spacing, by how it slows shear
// that is slower than noise.
constexpr double CALM_VISCOSITY = 0.012;
constexpr std::size_t CALMED = 8;

// Weight by distance over the radius, and its slope over the distance, both by the radius and
// without their scale. Of those of its kind it is the one that makes lattices of this radius
// nearly as dense when they are strained: where a lattice is the least dense of all, fluid sets,
// and bodies stick in it.
struct Weight {
  static double at(double q) {
    const double left = 1 - q;
    return left * left * left * (1 + 3 * q - 3 * q * q);
  }
  // Slope over q.
  static double slope(double q) {
    const double left = 1 - q;
    return -3 * q * left * left * (6 - 5 * q);
  }
};

// What half-spaces and other shapes add to the density of those near them.
class Walls {
 public:
  Walls();

  // Sum of the weights of a lattice, one's own among them.
  static double lattice();

  // Share of what a particle sees that is beyond a surface of a curvature (1 over the radius
  // of a ball, 0 of a plane) at a distance, both in radii, and its slope over the distance.
  void share(double distance, double curvature, double& value, double& slope) const;

  // Sum of squares of the slopes of the density of a lattice, in radii.
  static double steepness();

  // Pressure of the layers that a wall is in place of, by the way to them, over what they add
  // to the density and the multiplier (R. Clausius's virial).
  static double virial();

  // What all of it would add, in sums of weights.
  double whole() const { return whole_; }

 private:
  static constexpr int SHELLS = 16, KNOTS = 257;
  void integral(double distance, double curvature, double& value, double& slope) const;

  double radii_[SHELLS], weights_[SHELLS];
  double scale_ = 1;  // of distances
  double whole_ = 1;
  double flat_[KNOTS][2];
};

const Walls& walls();

// What a collider adds to the density of a particle, as a share of all that may be there.
struct Beyond {
  double share = 0, distance = 0;
  Vec slope;   // of the share, in the world [1/m]
  Vec push;    // what of it presses: see `beyond_box`
  Vec normal;  // the way out of the collider
};

Beyond beyond(const collide::Collider& c, const collide::Pose& pose, Vec point, double radius);

}  // namespace animtool::fluid
