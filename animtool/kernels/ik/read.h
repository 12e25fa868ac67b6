// Reads and checks the arrays of an IK problem.
#pragma once

#include "base/checks.h"
#include "ik/goals.h"
#include "ik/solve.h"

namespace animtool::ik {

Chain read_chain(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers);

Task read_task(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers,
               const In<std::int64_t, 2>& goals, const In<double, 2>& goal_numbers,
               double rest_weight);

// Checks the shape of poses (B, Q). Poses and targets may contain any numbers: NaN results are
// valid outcomes.
void check_poses(const char* name, const Task& task, std::size_t batch_size,
                 const In<double, 2>& poses);

// Checks targets (B, E, W). Factors of weights must not be negative: rows that a goal does not have
// would be written.
void check_targets(const char* name, const Task& task, std::size_t batch_size,
                   const In<double, 3>& targets);

// Checks the tolerances and the damping of a solver.
void check_tolerances(double length, double angle, double damping);

// Checks the shape of steps between frames, (F - 1, D) or more.
void check_steps(const char* name, const In<double, 2>& steps, std::size_t frames, int dofs);

}  // namespace animtool::ik
