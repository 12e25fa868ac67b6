// Runs a solver on consecutive problems.
#pragma once

#include <memory>

#include "ik/attempt.h"

namespace animtool::ik {

// Creates the solver of a method number; raises an error if it does not support the chain.
std::unique_ptr<Solver> make_solver(int method, Task& task, const Settings& settings);

// Raises an error for numbers out of range.
Settings checked_settings(const Settings& settings);

struct Ran {
  Outcome outcome;
  double seconds;
};

// Targets that errors refer to, those within reach, factors of bone lengths (E,), and the
// preferred pose; `next` is the frame after the last run.
Ran run_one(Solver& solver, const Chain& plain, Task& task, const double* start,
            const double* targets, const double* reachable, const double* stretches,
            const double* rest, bool next);

}  // namespace animtool::ik
