// Drives of joints: springs and dampers with exact motion in a substep, for any stiffness and
// damping, if other forces are constant in it.
//
// The effective mass of a drive is its response to an impulse, with all joints around it. Other
// forces are taken from the velocities that are being solved, so that contacts, limits and joints
// are solved together with drives. Hochbruck and Ostermann (2010), "Exponential integrators",
// section 2.3.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "rigid/joints.h"

namespace animtool::rigid {

// State of one drive equation between steps.
struct Drive {
  double mass = 0;            // effective mass; 0 without an equation
  bool is_mass_free = false;  // whether joints let the drive move that mass
  double speed = 0;           // speed at the start of a substep
  double error = 0;           // position error at the start of a substep
  double first_impulse = 0;   // impulse of the first half of a substep
};

using Drives = std::array<Drive, 3>;

inline bool has_drive(const Joint& joint) { return joint.stiffness > 0 || joint.damping > 0; }

// Angular frequency of a drive of a mass [1/s]; 0 if it creeps, or comes to rest within a time.
double drive_frequency(const Joint& joint, double mass, double time);

// Sets the impulse of a drive's row for the first half of a substep, from position and speed.
void begin_drive(const Joint& joint, Drive& drive, Row& row, double speed, double h);

// Sets the impulse for both halves of a substep, from the speed of the motion.
void end_drive(const Joint& joint, const Drive& drive, Row& row, double speed, double h);

// Computes the effective masses of drives in an island, given its rows. Returns whether no joint
// equation is redundant, or nearly redundant.
bool update_drive_masses(const std::vector<Joint>& joints, const std::vector<std::size_t>& island,
                         const std::vector<Rows>& rows, const std::vector<Speed>& speeds,
                         std::vector<Drives>& drives);

}  // namespace animtool::rigid
