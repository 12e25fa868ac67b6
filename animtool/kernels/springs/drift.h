// Relative displacement of nearby particles.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "springs/rigid_motion.h"
#include "springs/rows.h"

namespace animtool {

// Bounds of the relative displacement of two particles: nearby ones, and any.
struct Drift {
  double near = 0, all = 0;
};

// Particles in wide cells. Parts that move rigidly together have a small relative displacement,
// however fast they are.
class RelativeMotion {
 public:
  // Nearby particles are in the same or an adjacent cell: all that are within a cell width.
  void build(const std::vector<double>& x, double width);
  double width() const { return width_; }
  Drift between(const std::vector<double>& from, const std::vector<double>& to);
  // Relative to the rigid motion of all, which changes no distances.
  Drift between(const std::vector<double>& from, const std::vector<double>& to,
                const RigidMotion& shift);

 private:
  // Smallest and largest displacement in a cell along each axis.
  struct Range {
    double low[3], high[3];
  };
  template <class Shift>
  Drift relative(const std::vector<double>& from, const std::vector<double>& to, Shift shift);
  static double extent(const Range& one, const Range& other);

  double width_ = 0;
  std::vector<std::uint32_t> cells_;                               // of particles
  std::vector<std::pair<std::uint32_t, std::uint32_t>> adjacent_;  // cells
  std::vector<Range> ranges_;                                      // of cells
};

}  // namespace animtool
