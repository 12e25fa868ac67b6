// Inverse kinematics of consecutive poses.
#include "ik/solve.h"

#include <chrono>
#include <cmath>
#include <memory>

#include "ik/levels.h"
#include "ik/methods.h"
#include "ik/read.h"
#include "ik/run.h"

namespace animtool {

namespace ik {

std::unique_ptr<Solver> make_solver(int method, Task& task, const Settings& settings) {
  check::between("method", method, 0, 4);
  for (const Node& node : task.chain.nodes)
    if (method == 4 && node.kind == Kind::SLIDE)
      check::refuse("method", "FABRIK turns joints, and one slides");
  switch (method) {
    case 1:
      return std::make_unique<Gradient>(task, settings);
    case 2:
      return std::make_unique<Newton>(task, settings);
    case 3:
      return std::make_unique<CyclicDescent>(task, settings);
    case 4:
      return std::make_unique<Fabrik>(task, settings);
  }
  return std::make_unique<PrioritySolver>(task, settings);
}

Settings checked_settings(const Settings& settings) {
  check_tolerances(settings.length_tolerance, settings.angle_tolerance, settings.damping);
  constexpr int max_int = std::numeric_limits<int>::max();
  check::between("iterations", settings.iterations, 0, max_int);
  check::between("restarts", settings.restarts, 0, max_int);
  check::between("seconds", settings.seconds, 0, HUGE_VAL);
  return settings;
}

RunResult run_one(Solver& solver, const Chain& unstretched, Task& task, const double* start,
                  const double* targets, const double* reachable, const double* stretch_factors,
                  const double* rest, bool is_next_frame) {
  const auto start_time = std::chrono::steady_clock::now();
  const std::size_t width = task.goals.size() * TARGET_WIDTH;
  stretch_limbs(unstretched, stretch_factors, task);
  const Outcome outcome = solver.run(start, reachable, rest, is_next_frame);
  if (!std::equal(targets, targets + width, reachable)) solver.reevaluate(targets);
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start_time;
  return {outcome, elapsed.count()};
}

}  // namespace ik

using namespace ik;

// Converts targets of a rig to those of a chain, in place.
void to_chain_targets(Filled<double, 3> targets, In<double, 2> frames, double length) {
  const std::size_t goal_count = targets.shape(1);
  check::shape("targets", targets, {check::ANY, check::ANY, TARGET_WIDTH});
  check::shape("frames", frames, {goal_count, 4});
  check::positive("length", length);
  for (std::size_t row = 0; row < targets.shape(0) * goal_count; ++row) {
    double* target = targets.data() + TARGET_WIDTH * row;
    const double* frame = frames.data() + 4 * (row % goal_count);
    for_each_kind([&]<class Kind>(int component) {
      Kind::convert_target(target + TARGET_OFFSETS[component], frame, length);
    });
  }
}

std::vector<IkGoalKind> ik_goal_kinds() {
  std::vector<IkGoalKind> kinds;
  for_each_kind([&]<class Kind>(int) {
    kinds.emplace_back(Kind::NAME, Kind::RESIDUAL_COUNT, Kind::TARGET_SIZE, Kind::IS_LENGTH,
                       Alignable<Kind>);
  });
  return kinds;
}

IkSolveResult solve_ik(const IkProblems& problems) {
  const auto& [nodes, numbers, goals, goal_numbers, starts, targets, reachable, stretches, rests,
               rest_weight, length_tolerance, angle_tolerance, damping, iterations, restarts, seed,
               seconds, is_sequential, starts_from_previous, method] = problems;
  Task task = read_task(nodes, numbers, goals, goal_numbers, rest_weight);
  const Chain unstretched = task.chain;
  const std::size_t batch_size = starts.shape(0), width = starts.shape(1),
                    goal_count = goals.shape(0);
  check_poses("starts", task, batch_size, starts);
  check_poses("rests", task, batch_size, rests);
  check_targets("targets", task, batch_size, targets);
  check_targets("reachable", task, batch_size, reachable);
  check::shape("stretches", stretches, {batch_size, goal_count});
  const Settings settings =
      checked_settings({length_tolerance, angle_tolerance, damping, iterations, restarts, seed,
                        seconds, is_sequential && !starts_from_previous});
  Out<double, 2> solutions(batch_size, width);
  Out<double, 3> errors(batch_size, goal_count, COMPONENT_COUNT);
  Out<double, 1> run_times(batch_size);
  Out<std::int64_t, 2> reports(batch_size, 3);
  const std::unique_ptr<Solver> solver = make_solver(method, task, settings);
  for (std::size_t b = 0; b < batch_size; ++b) {
    const std::size_t offset = b * goal_count * TARGET_WIDTH;
    const bool is_next_frame = (is_sequential || starts_from_previous) && b > 0;
    const double* start = starts_from_previous && b > 0 ? solutions.get() + (b - 1) * width
                                                        : starts.data() + b * width;
    const auto [outcome, elapsed] = run_one(
        *solver, unstretched, task, start, targets.data() + offset, reachable.data() + offset,
        stretches.data() + b * goal_count, rests.data() + b * width, is_next_frame);
    run_times.get()[b] = elapsed;
    const State& best = solver->best();
    const double* q = outcome.status == Status::NOT_FINITE ? start : best.q.data();
    std::copy(q, q + width, solutions.get() + b * width);
    std::copy(best.errors.begin(), best.errors.end(),
              errors.get() + b * goal_count * COMPONENT_COUNT);
    std::int64_t* report = reports.get() + 3 * b;
    report[0] = static_cast<std::int64_t>(outcome.status);
    report[1] = outcome.iterations;
    report[2] = outcome.descent_count;
  }
  return {std::move(solutions), std::move(errors), std::move(reports), std::move(run_times)};
}

IkLinearization linearize_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                             In<std::int64_t, 2> goals, In<double, 2> goal_numbers,
                             In<double, 2> starts, In<double, 3> targets, In<double, 2> steps) {
  const Task task = read_task(nodes, numbers, goals, goal_numbers, 0);
  const std::size_t batch_size = starts.shape(0), width = starts.shape(1),
                    dof_count = task.chain.dof_count;
  const std::size_t row_count = task.row_count;
  check_poses("starts", task, batch_size, starts);
  check_targets("targets", task, batch_size, targets);
  check::shape("steps", steps, {batch_size, dof_count});
  Out<double, 2> poses(batch_size, width), residuals(batch_size, row_count),
      curvatures(batch_size, dof_count);
  Out<double, 3> jacobians(batch_size, row_count, dof_count);
  Stepper stepper(task);
  State state(task);
  Linearized linear(task);
  for (std::size_t b = 0; b < batch_size; ++b) {
    const double* step = steps.data() + b * dof_count;
    stepper.move(starts.data() + b * width, step, poses.get() + b * width);
    std::copy(poses.get() + b * width, poses.get() + (b + 1) * width, state.q.begin());
    compute_frames(task.chain, state.q.data(), state.frames);
    measure(task, targets.data() + b * goals.shape(0) * TARGET_WIDTH, state);
    linearize(task, targets.data() + b * goals.shape(0) * TARGET_WIDTH, state.q.data(), state,
              linear);
    std::copy(state.residuals.begin(), state.residuals.end(), residuals.get() + b * row_count);
    for (std::size_t i = 0; i < row_count; ++i)
      for (std::size_t j = 0; j < dof_count; ++j)
        jacobians.get()[(b * row_count + i) * dof_count + j] = linear.columns[j * row_count + i];
    stepper.multiply_hessian(state, linear, true, 0.0, step, curvatures.get() + b * dof_count);
  }
  return {std::move(poses), std::move(residuals), std::move(jacobians), std::move(curvatures)};
}

}  // namespace animtool
