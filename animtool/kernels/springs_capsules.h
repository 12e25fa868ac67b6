// Capsules that the particles of a network keep out of.
#pragma once

#include "springs.h"

namespace animtool {

class SpringCapsules {
 public:
  SpringCapsules(In<double, 1> knots, In<double, 3> ends, In<double, 1> radii,
                 In<double, 2> depths, double friction, double depenetration);

  std::size_t particles() const { return particles_; }
  bool empty() const { return radii_.empty(); }

  // Moves rows of particles out of the capsules as these are at the end of a step; those of
  // no inverse mass stay. What is deeper at the begin of the step than it may be comes out
  // no faster than the depenetration speed. Returns how many were moved.
  std::int64_t keep_out(double t, double h, const std::vector<double>& inverse_masses,
                        const double* before, double* x);

  // How many particles are deeper than they may be by more than a tolerance.
  std::int64_t inside(double t, double tolerance, const std::vector<double>& inverse_masses,
                      const double* x);

 private:
  void place(double t, std::vector<double>& ends) const;

  std::size_t particles_;
  std::vector<double> knots_, radii_, depths_;
  Track track_;  // of both ends of each
  double friction_, depenetration_;
  std::vector<double> was_, now_;  // (C, 2, 3)
};

}  // namespace animtool
