// Converts the coordinates of a rig to those of a chain, and back.
#pragma once

#include <cstdint>
#include <vector>

#include "base/arrays.h"
#include "ik/chain.h"

namespace animtool::ik {

// As in Python: for each coordinate of the chain, its column in the rig, its scale, and its period,
// infinite for coordinates that are not periodic; for each ball, its first coordinate and
// ball_from_joint; for each mimic joint, its column and that of its leader, and its gain and
// offset.
struct RigMapArrays {
  In<std::int64_t, 1> columns;
  In<double, 1> scales;
  In<double, 2> periods;
  In<std::int64_t, 1> balls;
  In<double, 2> ball_frames;
  In<std::int64_t, 2> mimics;
  In<double, 2> mimic_numbers;
};

class RigMap {
 public:
  // `width` is the number of coordinates of the rig.
  RigMap(const RigMapArrays& arrays, const Chain& chain, std::size_t width);

  void to_chain(const double* rig, double* q) const;

  // Converts to a row of the rig's coordinates; coordinates that are not in the chain stay.
  void to_rig(const double* q, double* rig) const;

 private:
  struct Coordinate {
    std::size_t column;
    double scale, low, high;
  };
  struct Ball {
    std::size_t first_coordinate;
    double frame[4], inverse_frame[4];
  };
  struct Mimic {
    std::size_t column, leader;
    double gain, offset;
  };

  std::vector<Coordinate> coordinates_;
  std::vector<Ball> balls_;
  std::vector<Mimic> mimics_;
};

}  // namespace animtool::ik
