// How far particles that are near each other moved over each other.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "springs/rigid_way.h"
#include "springs/rows.h"

namespace animtool {

// Bounds of how far any two particles moved over each other: those that were near, and all.
struct Drift {
  double near = 0, all = 0;
};

// Particles in wide cells. What goes along as a whole, or turns slowly, hardly moves over what
// is near it, however fast it is.
class NearMotion {
 public:
  // Near is in the same cell or in one beside it: all that is no farther than its width.
  void build(const std::vector<double>& x, double width);
  double width() const { return width_; }
  Drift between(const std::vector<double>& from, const std::vector<double>& to);
  // Beside what a rigid motion of all does, which brings none nearer to another.
  Drift between(const std::vector<double>& from, const std::vector<double>& to,
                const RigidWay& way);

 private:
  // What ways there are in a cell, at least and at most along each axis.
  struct Range {
    double low[3], high[3];
  };
  template <class Way>
  Drift beside(const std::vector<double>& from, const std::vector<double>& to, Way way);
  static double spread(const Range& one, const Range& other);

  double width_ = 0;
  std::vector<std::uint32_t> cells_;                             // of particles
  std::vector<std::pair<std::uint32_t, std::uint32_t>> beside_;  // cells
  std::vector<Range> ranges_;                                    // of cells
};

}  // namespace animtool
