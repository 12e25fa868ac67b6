// Drives of joints: springs and dampers whose motion is exact in a small step, whatever their
// stiffness and damping, where what else pulls does not change in it.
//
// The mass that a drive moves is what an impulse of it finds, with all joints around. What else
// pulls is read off the velocities that are being solved, so that contacts, limits and joints are
// solved with drives. Hochbruck and Ostermann (2010), "Exponential integrators", section 2.3.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "rigid/joints.h"

namespace animtool::rigid {

// Of one equation of a drive, from step to step.
struct Drive {
  double mass = 0;    // that it moves; 0 where it has no equation
  bool known = false; // whether joints let it feel that
  double speed = 0;   // where a small step begins
  double error = 0;
  double first = 0;   // impulse of the first half of a small step
};

using Drives = std::array<Drive, 3>;

inline bool driven(const Joint& joint) { return joint.stiffness > 0 || joint.damping > 0; }

// How fast a drive of a mass swings [1/s]; 0 where it creeps, or is at rest before a time is over.
double swing_of(const Joint& joint, double mass, double time);

// What a row of a drive does in the first half of a small step, from where it is and how fast.
void begin_drive(const Joint& joint, Drive& drive, Row& row, double speed, double h);

// And in both halves, from the speed with which bodies went on.
void end_drive(const Joint& joint, const Drive& drive, Row& row, double speed, double h);

// Finds the masses that drives move among the joints of an island, whose rows are theirs. Returns
// whether it knows that no equation of these joints is implied by others, or nearly.
bool find_masses(const std::vector<Joint>& joints, const std::vector<std::size_t>& island,
                 const std::vector<Rows>& rows, const std::vector<Speed>& speeds,
                 std::vector<Drives>& drives);

}  // namespace animtool::rigid
