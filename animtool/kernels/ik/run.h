// Runs a solver on consecutive problems.
#pragma once

#include <memory>

#include "ik/attempt.h"

namespace animtool::ik {

// By method number; refuses methods that do not support the chain.
std::unique_ptr<Solver> make_solver(int method, Task& task, const Settings& settings);

// Refuses numbers out of their range.
Settings checked_settings(const Settings& settings);

struct Ran {
  Outcome outcome;
  double seconds;
};

// Targets that misses are told of, those in reach, what bones are multiplied by (E,), and the
// pose preferred; `next` is the frame after the last run.
Ran run_one(Solver& solver, const Chain& plain, Task& task, const double* start,
            const double* targets, const double* sought, const double* stretches,
            const double* rest, bool next);

}  // namespace animtool::ik
