// Maps coordinates of a rig to those of a chain, and back.
#pragma once

#include <cstdint>
#include <vector>

#include "base/arrays.h"
#include "ik/chain.h"

namespace animtool::ik {

// As Python has it: of each coordinate of the chain its column in the rig, what it is divided
// by, and least and largest of one that turns all the way round, else infinite; of each ball
// its first coordinate and ball_from_joint; of each joint that mimics another its column, that
// of its leader, gain and offset, as often as a row of followers is long.
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
  // `width`: coordinates of the rig.
  RigMap(const RigMapArrays& arrays, const Chain& chain, std::size_t width);

  void to_chain(const double* rig, double* q) const;

  // Writes into a row of the rig's coordinates; coordinates that are not in the chain stay.
  void to_rig(const double* q, double* rig) const;

 private:
  struct Coordinate {
    std::size_t column;
    double scale, low, high;
  };
  struct Ball {
    std::size_t first;
    double frame[4], back[4];
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
