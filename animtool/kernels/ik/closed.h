// Closed-form solvers.
#pragma once

#include <memory>

#include "ik/goals.h"

namespace animtool::ik {

// Closed form of one kind of chain with one goal.
class ClosedForm {
 public:
  virtual ~ClosedForm() = default;

  // Writes a pose `q` and its errors (K,), from two sets of packed targets: those that errors
  // refer to, and those within reach. Returns false if the pose violates limits or does not
  // reach the target, so that another solver has to search.
  virtual bool solve(const double* start, const double* target, const double* reachable,
                     double scale, double* q, double* errors) = 0;

  // Whether the solution depends on the start, so that each frame of a clip starts at the
  // previous one.
  virtual bool follows() const = 0;
};

// A limb of two bones, see two_bone.cpp; the chain is one.
std::unique_ptr<ClosedForm> make_limb(const Task& task);

// The arguments for the closed form of an arm of six pins, with a goal of position and orientation.
enum class ArmKind { NONE = 0, WRIST = 1, PARALLEL = 2 };

ArmKind arm_kind(const Task& task);

// The closed form of such an arm, see arm.cpp: at most 8 poses within the limits reach a target.
class Arm : public ClosedForm {
 public:
  virtual std::size_t branches(const double* start, const double* target, double* poses) = 0;
};

constexpr std::size_t MAX_BRANCHES = 8, ARM_PINS = 6;

std::unique_ptr<Arm> make_arm(const Task& task, double length_tolerance, double angle_tolerance);

}  // namespace animtool::ik
