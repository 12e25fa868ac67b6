// Closed-form solvers.
#pragma once

#include <memory>

#include "ik/goals.h"

namespace animtool::ik {

// Closed form for one kind of chain with one goal.
class ClosedForm {
 public:
  virtual ~ClosedForm() = default;

  // Computes a pose `q` and its errors (K,) from two sets of packed targets: those that errors
  // refer to, and those that the limb can reach. Returns false if the pose violates limits or does
  // not reach the target, so that another solver has to search.
  virtual bool solve(const double* start, const double* target, const double* reachable,
                     double scale, double* q, double* errors) = 0;

  // Whether the solution depends on the start, so that each frame of a clip starts at the previous
  // one.
  virtual bool depends_on_start() const = 0;
};

// The closed form of a limb of two bones, see two_bone.cpp; the task must be one.
std::unique_ptr<ClosedForm> make_limb(const Task& task);

// Kinds of six-pin arms with a closed form, for a goal of position and orientation.
enum class ArmKind { NONE = 0, WRIST = 1, PARALLEL = 2 };

ArmKind arm_kind(const Task& task);

// The closed form of a six-pin arm, see arm.cpp: at most 8 poses within the limits reach a target.
class Arm : public ClosedForm {
 public:
  // Computes all poses that reach a target; returns their number.
  virtual std::size_t branches(const double* start, const double* target, double* poses) = 0;
};

constexpr std::size_t MAX_BRANCHES = 8, ARM_PINS = 6;

std::unique_ptr<Arm> make_arm(const Task& task, double length_tolerance, double angle_tolerance);

}  // namespace animtool::ik
