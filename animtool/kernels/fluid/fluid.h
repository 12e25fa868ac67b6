// Particles of a fluid: their density, and steps that keep it at the rest density (M. Macklin, M.
// Müller, "Position based fluids", 2013; M. Macklin et al., "Small steps in physics simulation",
// 2019).
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "colliders/colliders.h"

namespace animtool::fluid {

using collide::Vec;

// Interaction radius of particles, in spacings.
constexpr double REACH = 2.0;
// Margin of neighbour lists beyond the radius, over the radius.
constexpr double SKIN = 0.15;
// Effective gap to walls and bodies, in spacings, calibrated by the displaced volume of fluid.
constexpr double WALL_GAP = 0.02, BODY_GAP = 0.12;
// Relaxation of a step to the lattice solution: all particles move at once, and steps of more than
// two thirds diverge if every second one is dense. All have the same stiffness, so that pressure
// has a potential: otherwise it would drive circulation forever. Much denser particles are less
// stiff, by this fraction of their squared gradients.
constexpr double RELAXATION = 0.45, GRADIENT_DAMPING = 0.6;
// Pairs that separate or approach by less than this over the speed of sound are noise, which decays
// by NOISE_DECAY each time sound travels one spacing; faster ones hardly decay. This many substeps
// are combined.
constexpr double NOISE = 1.6e-3, NOISE_DECAY = 0.1;
// Its equivalent viscosity, over the speed of sound and the spacing, from how it slows shear slower
// than noise.
constexpr double NOISE_VISCOSITY = 0.012;
constexpr std::size_t NOISE_SUBSTEPS = 8;

// Kernel weight by distance over the radius, and its derivative over the distance, both by the
// radius and unscaled. Of its family it is the one that keeps lattices of this radius nearly as
// dense under strain: otherwise fluid sets, and bodies stick in it.
struct Weight {
  static double at(double q) {
    const double remaining = 1 - q;
    return remaining * remaining * remaining * (1 + 3 * q - 3 * q * q);
  }
  // Derivative over q.
  static double slope(double q) {
    const double remaining = 1 - q;
    return -3 * q * remaining * remaining * (6 - 5 * q);
  }
};

// Contribution of half-spaces and other shapes to the density of particles nearby.
class Walls {
 public:
  Walls();

  // Sum of the weights of a lattice, with the particle itself.
  static double lattice();

  // Fraction of a particle's ball beyond a surface of a curvature (1 over the radius of a ball, 0
  // for a plane) at a distance, both in radii, and its derivative over the distance.
  void fraction(double distance, double curvature, double& value, double& slope) const;

  // Sum of squared density gradients of a lattice, in radii.
  static double steepness();

  // Pressure of the layers that a wall replaces, by the offset to them, over their density
  // contribution and the multiplier (virial of R. Clausius).
  static double virial();

  // Contribution of the full half-space, in sums of weights.
  double full() const { return full_; }

 private:
  static constexpr int SHELLS = 16, KNOTS = 257;
  void integral(double distance, double curvature, double& value, double& slope) const;

  double radii_[SHELLS], weights_[SHELLS];
  double scale_ = 1;  // of distances
  double full_ = 1;
  double flat_[KNOTS][2];
};

const Walls& walls();

// Contribution of a collider to the density of a particle, as a fraction of the full one.
struct WallContribution {
  double fraction = 0, distance = 0;
  Vec slope;   // gradient of the fraction, in the world [1/m]
  Vec push;    // pressing part of it: see `box_contribution`
  Vec normal;  // outward direction of the collider
};

WallContribution wall_contribution(const collide::Collider& c, const collide::Pose& pose, Vec point,
                                   double radius);

}  // namespace animtool::fluid
