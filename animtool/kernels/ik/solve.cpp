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
      return std::make_unique<Cyclic>(task, settings);
    case 4:
      return std::make_unique<Fabrik>(task, settings);
  }
  return std::make_unique<Levels>(task, settings);
}

Settings checked_settings(const Settings& settings) {
  check_tolerances(settings.length_tolerance, settings.angle_tolerance, settings.damping);
  constexpr int most = std::numeric_limits<int>::max();
  check::between("iterations", settings.iterations, 0, most);
  check::between("restarts", settings.restarts, 0, most);
  check::between("seconds", settings.seconds, 0, HUGE_VAL);
  return settings;
}

Ran run_one(Solver& solver, const Chain& plain, Task& task, const double* start,
            const double* targets, const double* reachable, const double* stretches,
            const double* rest, bool next) {
  const auto began = std::chrono::steady_clock::now();
  const std::size_t width = task.goals.size() * TARGET_WIDTH;
  stretch(plain, stretches, task);
  const Outcome outcome = solver.run(start, reachable, rest, next);
  if (!std::equal(targets, targets + width, reachable)) solver.review(targets);
  const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - began;
  return {outcome, spent.count()};
}

}  // namespace ik

using namespace ik;

void to_chain_targets(Filled<double, 3> targets, In<double, 2> frames, double length) {
  const std::size_t goals = targets.shape(1);
  check::shape("targets", targets, {check::ANY, check::ANY, TARGET_WIDTH});
  check::shape("frames", frames, {goals, 4});
  check::positive("length", length);
  for (std::size_t row = 0; row < targets.shape(0) * goals; ++row) {
    double* target = targets.data() + TARGET_WIDTH * row;
    const double* frame = frames.data() + 4 * (row % goals);
    each_kind([&]<class Kind>(int part) { Kind::to_chain(target + COLUMNS[part], frame, length); });
  }
}

std::vector<IkGoalKind> ik_goal_kinds() {
  std::vector<IkGoalKind> kinds;
  each_kind([&]<class Kind>(int) {
    kinds.emplace_back(Kind::NAME, Kind::ROWS, Kind::WIDTH, Kind::METRIC, Pulling<Kind>);
  });
  return kinds;
}

IkSolved solve_ik(const IkProblems& problems) {
  const auto& [nodes, numbers, goals, goal_numbers, starts, targets, reachable, stretches, rests,
               rest_weight, length_tolerance, angle_tolerance, damping, iterations, restarts, seed,
               seconds, ordered, warm, method] = problems;
  Task task = read_task(nodes, numbers, goals, goal_numbers, rest_weight);
  const Chain plain = task.chain;
  const std::size_t batch = starts.shape(0), width = starts.shape(1), e = goals.shape(0);
  check_poses("starts", task, batch, starts);
  check_poses("rests", task, batch, rests);
  check_targets("targets", task, batch, targets);
  check_targets("reachable", task, batch, reachable);
  check::shape("stretches", stretches, {batch, e});
  const Settings settings =
      checked_settings({length_tolerance, angle_tolerance, damping, iterations, restarts, seed,
                        seconds, ordered && !warm});
  Out<double, 2> solved(batch, width);
  Out<double, 3> errors(batch, e, PARTS);
  Out<double, 1> taken(batch);
  Out<std::int64_t, 2> reports(batch, 3);
  const std::unique_ptr<Solver> solver = make_solver(method, task, settings);
  for (std::size_t b = 0; b < batch; ++b) {
    const std::size_t at = b * e * TARGET_WIDTH;
    const bool next = (ordered || warm) && b > 0;
    const double* start =
        warm && b > 0 ? solved.get() + (b - 1) * width : starts.data() + b * width;
    const auto [outcome, spent] =
        run_one(*solver, plain, task, start, targets.data() + at, reachable.data() + at,
                stretches.data() + b * e, rests.data() + b * width, next);
    taken.get()[b] = spent;
    const State& best = solver->best();
    const double* q = outcome.status == Status::BROKEN ? start : best.q.data();
    std::copy(q, q + width, solved.get() + b * width);
    std::copy(best.errors.begin(), best.errors.end(), errors.get() + b * e * PARTS);
    std::int64_t* report = reports.get() + 3 * b;
    report[0] = static_cast<std::int64_t>(outcome.status);
    report[1] = outcome.iterations;
    report[2] = outcome.descents;
  }
  return {std::move(solved), std::move(errors), std::move(reports), std::move(taken)};
}

IkLinearized linearize_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                          In<std::int64_t, 2> goals, In<double, 2> goal_numbers,
                          In<double, 2> starts, In<double, 3> targets, In<double, 2> steps) {
  const Task task = read_task(nodes, numbers, goals, goal_numbers, 0);
  const std::size_t batch = starts.shape(0), width = starts.shape(1), d = task.chain.dofs;
  const std::size_t m = task.rows;
  check_poses("starts", task, batch, starts);
  check_targets("targets", task, batch, targets);
  check::shape("steps", steps, {batch, d});
  Out<double, 2> moved(batch, width), residuals(batch, m), curvatures(batch, d);
  Out<double, 3> jacobians(batch, m, d);
  Stepper stepper(task);
  State state(task);
  Linearized linear(task);
  for (std::size_t b = 0; b < batch; ++b) {
    const double* step = steps.data() + b * d;
    stepper.move(starts.data() + b * width, step, moved.get() + b * width);
    std::copy(moved.get() + b * width, moved.get() + (b + 1) * width, state.q.begin());
    forward(task.chain, state.q.data(), state.frames);
    measure(task, targets.data() + b * goals.shape(0) * TARGET_WIDTH, state);
    linearize(task, targets.data() + b * goals.shape(0) * TARGET_WIDTH, state.q.data(), state,
              linear);
    std::copy(state.residuals.begin(), state.residuals.end(), residuals.get() + b * m);
    for (std::size_t i = 0; i < m; ++i)
      for (std::size_t j = 0; j < d; ++j)
        jacobians.get()[(b * m + i) * d + j] = linear.columns[j * m + i];
    stepper.hessian(state, linear, true, 0.0, step, curvatures.get() + b * d);
  }
  return {std::move(moved), std::move(residuals), std::move(jacobians), std::move(curvatures)};
}

}  // namespace animtool
