// Closed-form solvers.
#pragma once

#include <memory>

#include "ik/goals.h"

namespace animtool::ik {

// Closed form of one kind of chain with one goal.
class ClosedForm {
 public:
  virtual ~ClosedForm() = default;

  // Writes a pose `q` and what it misses (K,), from the packed targets: those that misses are
  // told of, and those in reach. False where it keeps no limits, or does not reach: another
  // solver has to look.
  virtual bool solve(const double* start, const double* target, const double* sought,
                     double scale, double* q, double* misses) = 0;

  // Whether the start decides among poses, so that frames of a clip start at the one before.
  virtual bool follows() const = 0;
};

// A limb of two bones, see two_bone.cpp; the chain is one.
std::unique_ptr<ClosedForm> make_limb(const Task& task);

// What makes a closed form of an arm of six pins, with a goal of position and orientation.
enum class ArmKind { NONE = 0, WRIST = 1, PARALLEL = 2 };

ArmKind arm_kind(const Task& task);

// Such an arm, see arm.cpp; its poses that reach a target, at most 8, within the limits.
class Arm : public ClosedForm {
 public:
  virtual std::size_t branches(const double* start, const double* target, double* poses) = 0;
};

constexpr std::size_t MOST_BRANCHES = 8, ARM_PINS = 6;

std::unique_ptr<Arm> make_arm(const Task& task, double length_tolerance, double angle_tolerance);

}  // namespace animtool::ik
