// Relative displacement of nearby particles.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "springs/rigid_motion.h"
#include "springs/rows.h"

namespace animtool {

// Bounds of the relative displacement of two particles: of nearby ones, and of any two.
struct Drift {
  double nearby_bound = 0, overall_bound = 0;
};

// Measures relative displacements with particles in wide cells. Groups that move rigidly have a
// small relative displacement, however fast they are.
class RelativeMotion {
 public:
  // Sorts particles into cells; particles within a cell width of each other are in the same or in
  // adjacent cells.
  void build(const std::vector<double>& x, double width);
  double width() const { return width_; }
  // Bounds relative displacements between two sets of positions.
  Drift measure(const std::vector<double>& from, const std::vector<double>& to);
  // Relative to a common rigid motion, which changes no distances.
  Drift measure(const std::vector<double>& from, const std::vector<double>& to,
                const RigidMotion& motion);

 private:
  // Smallest and largest displacement in a cell along each axis.
  struct Range {
    double low[3], high[3];
  };
  template <class Transform>
  Drift measure_relative_to(const std::vector<double>& from, const std::vector<double>& to,
                            Transform transform);
  static double combined_extent(const Range& a, const Range& b);

  double width_ = 0;
  std::vector<std::uint32_t> cell_of_particle_;                          // of particles
  std::vector<std::pair<std::uint32_t, std::uint32_t>> adjacent_cells_;  // cells
  std::vector<Range> cell_ranges_;                                       // of cells
};

}  // namespace animtool
