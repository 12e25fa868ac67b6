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
constexpr double RADIUS_RATIO = 2.0;
// Margin of neighbour lists beyond the radius, over the radius.
constexpr double LIST_MARGIN_RATIO = 0.15;
// Effective gaps to walls and to bodies, in spacings, calibrated by the volume of displaced fluid.
constexpr double WALL_GAP = 0.02, BODY_GAP = 0.12;
// Relaxation of a step to the lattice solution: all particles move simultaneously, and relaxations
// of more than two thirds diverge if every second particle is dense. All particles have the same
// stiffness, so that pressure has a potential; otherwise it would drive circulation forever. Much
// denser particles are less stiff, by this fraction of their squared gradients.
constexpr double RELAXATION = 0.45, GRADIENT_DAMPING = 0.6;
// Relative speeds of pairs below this, over the speed of sound, are noise. It decays by NOISE_DECAY
// each time sound travels one spacing; faster motion hardly decays. NOISE_SUBSTEPS are combined.
constexpr double NOISE_SPEED = 1.6e-3, NOISE_DECAY = 0.1;
// Viscosity that is equivalent to noise damping, over the speed of sound and the spacing, from how
// it slows shear below the noise speed.
constexpr double NOISE_VISCOSITY = 0.012;
constexpr std::size_t NOISE_SUBSTEPS = 8;

// Kernel weight by distance over the radius, and its derivative over the distance, unscaled. Of its
// family, this kernel is the one that keeps the density of lattices of this radius nearly constant
// under strain; with others, fluid solidifies and bodies stick in it.
struct Kernel {
  static double weight(double q) {
    const double remaining = 1 - q;
    return remaining * remaining * remaining * (1 + 3 * q - 3 * q * q);
  }
  // The derivative over q.
  static double derivative_over_q(double q) {
    const double remaining = 1 - q;
    return -3 * q * remaining * remaining * (6 - 5 * q);
  }
};

// Contributions of half-spaces and other shapes to the density of nearby particles.
class Walls {
 public:
  Walls();

  // Sum of the weights of a lattice, including the particle itself.
  static double lattice_weight_sum();

  // Computes the fraction of a particle's ball beyond a surface at a distance, and its derivative
  // over the distance. The curvature is 1 over the radius of a ball, 0 for a plane; lengths are in
  // radii.
  void fraction(double distance, double curvature, double& value, double& derivative) const;

  // Sum of squared density gradients in a lattice, in radii.
  static double lattice_steepness();

  // Pressure of the layers that a wall replaces, times the offset to them, over their density
  // contribution and the multiplier (virial of R. Clausius).
  static double virial();

  // Contribution of a full half-space, in sums of weights.
  double full_density() const { return full_density_; }

 private:
  static constexpr int SHELL_COUNT = 16, TABLE_KNOTS = 257;
  // Integrates over shells around the particle.
  void integrate(double distance, double curvature, double& value, double& derivative) const;

  double radii_[SHELL_COUNT], weights_[SHELL_COUNT];
  double scale_ = 1;  // of distances
  double full_density_ = 1;
  double plane_table_[TABLE_KNOTS][2];
};

const Walls& walls();

// Contribution of a collider to the density of a particle, as a fraction of the full density.
struct WallContribution {
  double fraction = 0, distance = 0;
  Vec gradient;           // gradient of the fraction, in the world [1/m]
  Vec pressing_gradient;  // the part of it that presses, see `box_contribution`
  Vec normal;             // outward direction of the collider
};

WallContribution wall_contribution(const collide::Collider& c, const collide::Pose& pose, Vec point,
                                   double radius);

}  // namespace animtool::fluid
