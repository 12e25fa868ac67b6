// Runs a solver on consecutive problems.
#pragma once

#include <memory>

#include "ik/attempt.h"

namespace animtool::ik {

// Creates the solver of a method number; raises an error if it does not support the chain.
std::unique_ptr<Solver> make_solver(int method, Task& task, const Settings& settings);

// Raises an error for numbers out of range.
Settings checked_settings(const Settings& settings);

struct RunResult {
  Outcome outcome;
  double seconds;
};

// Solves one problem: `targets` are those that errors refer to, `reachable` those that the limbs
// can reach, `stretch_factors` (E,) those of bone lengths, `rest` the preferred pose;
// `is_next_frame` if it is the frame after the last run.
RunResult run_one(Solver& solver, const Chain& unstretched, Task& task, const double* start,
                  const double* targets, const double* reachable, const double* stretch_factors,
                  const double* rest, bool is_next_frame);

}  // namespace animtool::ik
