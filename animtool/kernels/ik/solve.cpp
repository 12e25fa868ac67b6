// Inverse kinematics: the arrays of a problem to its task, and the search over them.
#include <chrono>
#include <cmath>
#include <memory>

#include "base/checks.h"
#include "ik/ccd.h"
#include "ik/fabrik.h"
#include "ik/fit.h"
#include "ik/levels.h"
#include "ik/path.h"
#include "ik/slopes.h"
#include "ik/smooth.h"
#include "ik/solve.h"
#include "ik/stretch.h"

namespace animtool {

namespace {

using namespace ik;

// A matrix of the rows is gone through with int.
constexpr std::size_t MOST_GOALS = 46340 / MOST_GOAL_ROWS;
// Of the first step of a fit to goals that are never reached.
constexpr double FIT_DAMPING = 1e-3;
// Of a goal: two parts of its offset and its aim axis, and its weights.
constexpr std::size_t GOAL_NUMBERS = 9 + PARTS;

// Frames and gains are finite; limits, which may be infinite, are in order.
void check_numbers(const Node& node, const double* values) {
  check::finite("numbers", values, 14);
  const double* l = values + 14;
  const bool ball = node.kind == Kind::BALL;
  const bool good = ball ? l[0] >= 0 && l[1] >= 0 && l[2] <= l[3] : l[0] <= l[1];
  if (!good) check::refuse("numbers", "limits are not in order");
}

// Rows behind those of the nodes hold programs: 3, its number, operation, and 1 more than
// the coordinate, program or count that this needs, these too counted from 1.
constexpr std::int64_t INSTRUCTION = 3;
// Of a node, in place of whether it follows a coordinate: its coordinate is a program.
constexpr std::int64_t FOLLOWS_PROGRAM = 2;
// Degrees of freedom that are gathered before doubles are taken out.
constexpr std::size_t MOST_ROWS_READ = 4 * MOST_SLOPES;

// What a program depends on: its own coordinates' degrees of freedom, and those of others.
void add_dofs(const Chain& chain, const std::vector<int>& dof_of, Program& program) {
  for (const Instruction& one : program.instructions) {
    if (one.op == Op::COORDINATE) program.dofs.push_back(dof_of[one.which]);
    if (one.op == Op::BALL)
      for (int k = 0; k < 3; ++k) program.dofs.push_back(dof_of[one.which] + k);
    if (one.op == Op::RESULT) {
      const std::vector<int>& others = chain.programs[one.which].dofs;
      program.dofs.insert(program.dofs.end(), others.begin(), others.end());
    }
    if (program.dofs.size() > MOST_ROWS_READ) {
      std::sort(program.dofs.begin(), program.dofs.end());
      program.dofs.erase(std::unique(program.dofs.begin(), program.dofs.end()),
                         program.dofs.end());
      if (program.dofs.size() > MOST_SLOPES) check::refuse("nodes", "a program reads too much");
    }
  }
  std::sort(program.dofs.begin(), program.dofs.end());
  program.dofs.erase(std::unique(program.dofs.begin(), program.dofs.end()), program.dofs.end());
  for (Instruction& one : program.instructions)
    if (one.op == Op::COORDINATE || one.op == Op::BALL) {
      const auto own = std::lower_bound(program.dofs.begin(), program.dofs.end(), dof_of[one.which]);
      one.slot = static_cast<int>(own - program.dofs.begin());
    }
}

// Counts the values stacked; what is left is one, and no instruction lacks a value.
void check_stack(Program& program) {
  std::size_t stacked = 0;
  int points = 0;
  for (const Instruction& one : program.instructions) {
    if (one.op == Op::POINT) {
      ++points;
      continue;
    }
    if (points != (one.op == Op::CURVE ? one.which : 0) || (one.op == Op::CURVE && !points))
      check::refuse("nodes", "a curve of a program has other points");
    points = 0;
    const std::size_t taken = arguments(one.op);
    if (stacked < taken) check::refuse("nodes", "a program takes what is not there");
    stacked += 1 - taken;
    program.depth = std::max(program.depth, stacked);
  }
  if (stacked != 1 || points || program.depth > MOST_STACKED)
    check::refuse("nodes", "a program does not come to one value");
}

// balls: whether a coordinate is a ball's first, by coordinate.
void read_programs(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers,
                   std::size_t first, const std::vector<int>& dof_of,
                   const std::vector<bool>& balls, Chain& chain) {
  const std::int64_t coordinates = chain.coordinates;
  std::size_t slopes = 0;
  for (std::size_t n = first; n < nodes.shape(0);) {
    Program program;
    const auto number = static_cast<std::int64_t>(chain.programs.size());
    for (; n < nodes.shape(0) && nodes.data()[4 * n + 1] == number; ++n) {
      const std::int64_t* row = nodes.data() + 4 * n;
      check::between("nodes", row[0], INSTRUCTION, INSTRUCTION);
      check::between("nodes", row[2], 0, static_cast<std::int64_t>(Op::COUNT) - 1);
      check::finite("numbers", numbers.data() + 18 * n, MOST_NUMBERS);
      check::between("nodes", row[3], 1, static_cast<std::int64_t>(check::MOST_ROWS));
      const std::int64_t which = row[3] - 1;
      Instruction one{static_cast<Op>(row[2]), 0, {}, 0};
      std::copy(numbers.data() + 18 * n, numbers.data() + 18 * n + MOST_NUMBERS, one.numbers);
      if (one.op == Op::COORDINATE || one.op == Op::BALL) {
        check::indices("nodes", &which, 1, 1, coordinates + 1);
        if (balls[which - 1] != (one.op == Op::BALL) || dof_of[which - 1] < 0)
          check::refuse("nodes", "a program reads no such coordinate");
      }
      if (one.op == Op::RESULT) check::indices("nodes", &which, 1, 1, number + 1);
      if (one.op == Op::CURVE) check::indices("nodes", &which, 1, 1, check::MOST_ROWS);
      one.which = static_cast<int>(one.op == Op::CURVE ? which : which - 1);
      program.instructions.push_back(one);
    }
    if (program.instructions.empty()) check::refuse("nodes", "programs are out of order");
    check_stack(program);
    add_dofs(chain, dof_of, program);
    program.first = slopes;
    slopes += program.dofs.size();
    chain.programs.push_back(std::move(program));
  }
}

Chain read_chain(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers) {
  check::shape("nodes", nodes, {check::ANY, 4});
  check::shape("numbers", numbers, {nodes.shape(0), 18});
  check::at_most("nodes", nodes.shape(0), check::MOST_ROWS);
  Chain chain;
  int coordinates = 0, dofs = 0;
  std::vector<int> dof_of;
  std::vector<bool> balls;
  std::size_t joints = 0;
  while (joints < nodes.shape(0) && nodes.data()[4 * joints] != INSTRUCTION) ++joints;
  for (std::size_t n = 0; n < joints; ++n) {
    const std::int64_t* row = nodes.data() + 4 * n;
    const double* values = numbers.data() + 18 * n;
    Node node{};
    node.program = -1;
    check::between("nodes", row[0], 0, static_cast<std::int64_t>(Kind::BALL));
    check::between("nodes", row[1], -1, static_cast<std::int64_t>(n) - 1);
    node.kind = static_cast<Kind>(row[0]);
    check_numbers(node, values);
    node.parent = static_cast<int>(row[1]);
    node.follows = row[3] != 0;
    std::copy(values, values + 9, node.rest);
    std::copy(values + 9, values + 12, node.offset);
    node.gain = values[12], node.shift = values[13];
    std::copy(values + 14, values + 18, node.limit);
    if (node.kind == Kind::BALL) prepare(node);
    if (row[3] == FOLLOWS_PROGRAM) {
      check::between("nodes", row[2], 0, check::MOST_ROWS);
      if (node.kind == Kind::BALL) check::refuse("nodes", "a ball follows no program");
      node.program = static_cast<int>(row[2]);
      chain.nodes.push_back(node);
      continue;
    }
    node.coordinate = static_cast<int>(row[2]);
    if (node.follows) {
      check::indices("nodes", row + 2, 1, 0, coordinates);
      if (node.kind == Kind::BALL || balls[row[2]] || dof_of[row[2]] < 0)
        check::refuse("nodes", "coordinate " + check::text(row[2]) + " is none to follow");
      node.dof = dof_of[row[2]];
    } else {
      check::between("nodes", row[2], coordinates, coordinates);
      const int size = node.kind == Kind::BALL ? 4 : 1;
      node.dof = dofs;
      dof_of.insert(dof_of.end(), size, -1);
      balls.insert(balls.end(), size, false);
      dof_of[coordinates] = dofs;
      balls[coordinates] = node.kind == Kind::BALL;
      coordinates += size;
      dofs += node.width();
    }
    chain.nodes.push_back(node);
  }
  chain.coordinates = coordinates;
  chain.dofs = dofs;
  read_programs(nodes, numbers, joints, dof_of, balls, chain);
  for (const Node& node : chain.nodes)
    if (node.program >= static_cast<int>(chain.programs.size()))
      check::refuse("nodes", "a joint follows no program");
  return chain;
}

Task read_task(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers,
               const In<std::int64_t, 2>& goals, const In<double, 2>& goal_numbers,
               double rest_weight) {
  check::shape("goals", goals, {check::ANY, 4});
  check::shape("goal_numbers", goal_numbers, {goals.shape(0), GOAL_NUMBERS});
  check::at_most("goals", goals.shape(0), MOST_GOALS);
  check::finite("goal_numbers", goal_numbers);
  check::not_negative("rest_weight", rest_weight);
  Task task;
  task.chain = read_chain(nodes, numbers);
  task.rest_weight = rest_weight;
  const std::int64_t count = static_cast<std::int64_t>(task.chain.nodes.size());
  for (std::size_t e = 0; e < goals.shape(0); ++e) {
    const std::int64_t* row = goals.data() + 4 * e;
    const double* values = goal_numbers.data() + GOAL_NUMBERS * e;
    check::indices("goals", row, 1, 0, count);
    check::indices("goals", row + 1, 2, -1, count);
    check::indices("goals", row + 3, 1, 0, static_cast<std::int64_t>(goals.shape(0)));
    for (int part = 0; part < PARTS; ++part)
      check::not_negative("goal_numbers", values[9 + part]);
    Goal goal;
    goal.node = static_cast<int>(row[0]);
    goal.root = static_cast<int>(row[1]);
    goal.middle = static_cast<int>(row[2]);
    std::copy(values, values + 3, goal.bone);
    std::copy(values + 3, values + 6, goal.tool);
    for (int i = 0; i < 3; ++i) goal.offset[i] = goal.bone[i] + goal.tool[i];
    std::copy(values + 6, values + 9, goal.aim_axis);
    std::copy(values + 9, values + GOAL_NUMBERS, goal.weights);
    goal.level = static_cast<int>(row[3]);
    task.levels = std::max(task.levels, goal.level + 1);
    each_kind([&]<class Kind>(int part) {
      if (Kind::LIMB && goal.weights[part] > 0 && (row[1] < 0 || row[2] < 0))
        check::refuse("goals", "goal " + check::text(e) + " has a " + Kind::NAME + " and no limb");
    });
    goal.row = task.rows;
    for (int n = goal.node; n >= 0; n = task.chain.nodes[n].parent) goal.path.push_back(n);
    std::reverse(goal.path.begin(), goal.path.end());
    task.rows += rows_of(goal);
    task.goals.push_back(goal);
  }
  return task;
}

// Poses (B, Q) may be of any numbers: what comes to none is an outcome, as it is of targets.
void check_poses(const char* name, const Task& task, std::size_t batch,
                 const In<double, 2>& poses) {
  check::shape(name, poses, {batch, static_cast<std::size_t>(task.chain.coordinates)});
}

// What weights of goals are multiplied by is no sign: rows that a goal has not would be
// written.
void check_targets(const char* name, const Task& task, std::size_t batch,
                   const In<double, 3>& targets) {
  check::shape(name, targets, {batch, task.goals.size(), TARGET_WIDTH});
  for (std::size_t row = 0; row < batch * task.goals.size(); ++row)
    for (int part = 0; part < PARTS; ++part) {
      const double by = targets.data()[TARGET_WIDTH * row + WEIGHTS + part];
      if (!(by >= 0)) check::refuse(name, "the share " + check::text(by) + " is not 0 or more");
    }
}

void check_method(int method, const Chain& chain) {
  check::between("method", method, 0, 4);
  if (method != 4) return;
  for (const Node& node : chain.nodes)
    if (node.kind == Kind::SLIDE) check::refuse("method", "FABRIK turns joints, and one slides");
}

void check_tolerances(double length, double angle, double damping) {
  check::not_negative("length_tolerance", length);
  check::not_negative("angle_tolerance", angle);
  check::not_negative("damping", damping);
}

// (F - 1, D) or more.
void check_steps(const char* name, const In<double, 2>& steps, std::size_t frames, int dofs) {
  const std::size_t count = std::max<std::size_t>(steps.shape(0), frames ? frames - 1 : 0);
  check::shape(name, steps, {count, static_cast<std::size_t>(dofs)});
}

std::unique_ptr<Solver> make_solver(int method, Task& task, const Settings& settings) {
  switch (method) {
    case 0:
      return std::make_unique<Levels>(task, settings);
    case 1:
      return std::make_unique<Gradient>(task, settings);
    case 2:
      return std::make_unique<Newton>(task, settings);
    case 3:
      return std::make_unique<Cyclic>(task, settings);
    case 4:
      return std::make_unique<Fabrik>(task, settings);
  }
  check::refuse("method", check::text(method) + " is not between 0 and 4");
}

}  // namespace

void place_ik_targets(Filled<double, 3> targets, In<double, 2> frames, double length) {
  const std::size_t goals = targets.shape(1);
  check::shape("targets", targets, {check::ANY, check::ANY, TARGET_WIDTH});
  check::shape("frames", frames, {goals, 4});
  check::positive("length", length);
  for (std::size_t row = 0; row < targets.shape(0) * goals; ++row) {
    double* target = targets.data() + TARGET_WIDTH * row;
    const double* frame = frames.data() + 4 * (row % goals);
    each_kind([&]<class Kind>(int part) { Kind::place(target + COLUMNS[part], frame, length); });
  }
}

std::vector<IkGoalKind> ik_goal_kinds() {
  std::vector<IkGoalKind> kinds;
  each_kind([&]<class Kind>(int) {
    kinds.emplace_back(Kind::NAME, Kind::ROWS, Kind::WIDTH, Kind::METRIC, Pulling<Kind>);
  });
  return kinds;
}

IkSolved solve_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers, In<std::int64_t, 2> goals,
                  In<double, 2> goal_numbers, In<double, 2> starts, In<double, 3> targets,
                  In<double, 3> sought, In<double, 2> stretches, In<double, 2> rests,
                  double rest_weight, double length_tolerance, double angle_tolerance,
                  double damping, int iterations, int restarts, std::uint64_t seed,
                  double seconds, bool ordered, bool warm, int method) {
  Task task = read_task(nodes, numbers, goals, goal_numbers, rest_weight);
  const Chain plain = task.chain;
  const std::size_t batch = starts.shape(0), width = starts.shape(1), e = goals.shape(0);
  check_poses("starts", task, batch, starts);
  check_poses("rests", task, batch, rests);
  check_targets("targets", task, batch, targets);
  check_targets("sought", task, batch, sought);
  check::shape("stretches", stretches, {batch, e});
  check_tolerances(length_tolerance, angle_tolerance, damping);
  constexpr int most = std::numeric_limits<int>::max();
  check::between("iterations", iterations, 0, most);
  check::between("restarts", restarts, 0, most);
  check::between("seconds", seconds, 0, HUGE_VAL);
  check_method(method, plain);
  const Settings settings{length_tolerance, angle_tolerance, damping, iterations,
                          restarts,         seed,            seconds,
                          ordered && !warm};
  Out<double, 2> solved(batch, width);
  Out<double, 3> misses(batch, e, PARTS);
  Out<double, 1> taken(batch);
  Out<std::int64_t, 2> reports(batch, 3);
  const std::unique_ptr<Solver> solver = make_solver(method, task, settings);
  for (std::size_t b = 0; b < batch; ++b) {
    const auto began = std::chrono::steady_clock::now();
    const std::size_t at = b * e * TARGET_WIDTH;
    const bool next = (ordered || warm) && b > 0;
    const double* start = warm && b > 0 ? solved.get() + (b - 1) * width : starts.data() + b * width;
    const double* given = targets.data() + at;
    stretch(plain, stretches.data() + b * e, task);
    const Outcome outcome =
        solver->run(start, sought.data() + at, rests.data() + b * width, next);
    if (!std::equal(given, given + e * TARGET_WIDTH, sought.data() + at)) solver->review(given);
    const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - began;
    taken.get()[b] = spent.count();
    const State& best = solver->best();
    const double* q = outcome.status == Status::BROKEN ? start : best.q.data();
    std::copy(q, q + width, solved.get() + b * width);
    std::copy(best.misses.begin(), best.misses.end(), misses.get() + b * e * PARTS);
    std::int64_t* report = reports.get() + 3 * b;
    report[0] = static_cast<std::int64_t>(outcome.status);
    report[1] = outcome.iterations;
    report[2] = outcome.descents;
  }
  return {std::move(solved), std::move(misses), std::move(reports),
          std::move(taken)};
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
  return {std::move(moved), std::move(residuals), std::move(jacobians),
          std::move(curvatures)};
}

IkSmoothed smooth_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                     In<std::int64_t, 2> goals, In<double, 2> goal_numbers, In<double, 2> path,
                     In<double, 3> targets, In<double, 3> sought, In<double, 2> stretches,
                     In<double, 2> drifts, double anchor, double speed, double acceleration,
                     std::size_t first, std::size_t end, double length_tolerance,
                     double angle_tolerance, double damping, int rounds) {
  Task task = read_task(nodes, numbers, goals, goal_numbers, 0);
  const Chain plain = task.chain;
  const std::size_t frames = path.shape(0), width = path.shape(1), e = goals.shape(0);
  check_poses("path", task, frames, path);
  check::at_most("path", frames, check::MOST_ROWS);
  check_targets("targets", task, frames, targets);
  check_targets("sought", task, frames, sought);
  check::shape("stretches", stretches, {frames, e});
  check_steps("drifts", drifts, frames, task.chain.dofs);
  check::not_negative("anchor", anchor);
  check::not_negative("speed", speed);
  check::not_negative("acceleration", acceleration);
  check::between("end", end, 0, frames);
  check::between("first", first, 0, end);
  check_tolerances(length_tolerance, angle_tolerance, damping);
  check::between("rounds", rounds, 0, std::numeric_limits<int>::max());
  const Settings settings{length_tolerance, angle_tolerance, damping, 1, 0, 0, 0, false};
  const PathSettings over{{anchor, speed, acceleration},
                          static_cast<int>(first), static_cast<int>(end), rounds};
  Out<double, 2> smoothed(frames, width);
  Out<double, 3> misses(frames, e, PARTS);
  PathOutcome outcome;
  std::copy(path.data(), path.data() + frames * width, smoothed.get());
  PathSmoother smoother(task, settings, over, static_cast<int>(frames), sought.data(),
                        stretches.data(), drifts.data());
  outcome = smoother.run(smoothed.get());
  State state(task);
  for (std::size_t t = 0; t < frames; ++t) {
    std::copy(smoothed.get() + t * width, smoothed.get() + (t + 1) * width, state.q.begin());
    stretch(plain, stretches.data() + t * e, task);
    forward(task.chain, state.q.data(), state.frames);
    measure(task, targets.data() + t * e * TARGET_WIDTH, state);
    std::copy(state.misses.begin(), state.misses.end(), misses.get() + t * e * PARTS);
  }
  return {std::move(smoothed), std::move(misses), outcome.rounds,
          outcome.before, outcome.after};
}

IkFitted fit_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers, In<std::int64_t, 2> goals,
                In<double, 2> goal_numbers, In<double, 2> path, In<double, 3> targets,
                In<double, 2> starts, double anchor, double speed, double acceleration,
                double robust, double rest_weight, double homing, std::size_t first,
                std::size_t end, int iterations, int rounds, bool tracked) {
  Task task = read_task(nodes, numbers, goals, goal_numbers, rest_weight);
  const std::size_t frames = path.shape(0), width = path.shape(1), e = goals.shape(0);
  check_poses("path", task, frames, path);
  check_poses("starts", task, frames, starts);
  check::at_most("path", frames, check::MOST_ROWS);
  check_targets("targets", task, frames, targets);
  check::positive("anchor", anchor);
  check::not_negative("speed", speed);
  check::not_negative("acceleration", acceleration);
  check::between("homing", homing, 0, 1);
  if (!(robust > 0)) check::refuse("robust", check::text(robust) + " is not above 0");
  check::between("end", end, 0, frames);
  check::between("first", first, 0, end);
  check::between("iterations", iterations, 0, std::numeric_limits<int>::max());
  check::between("rounds", rounds, 0, std::numeric_limits<int>::max());
  const Settings settings{0, 0, FIT_DAMPING, iterations, 0, 0, 0, false};
  const FitSettings over{{anchor, speed, acceleration},   robust, homing, static_cast<int>(first),
                         static_cast<int>(end), rounds, tracked};
  Out<double, 2> fitted(frames, width);
  Out<double, 3> misses(frames, e, PARTS);
  Out<std::int64_t, 1> searched(frames);
  Out<std::int64_t, 2> taken(frames, e);
  FitOutcome outcome;
  std::copy(path.data(), path.data() + frames * width, fitted.get());
  std::fill(searched.get(), searched.get() + frames, 0);
  PathFit fit(task, settings, over, static_cast<int>(frames), targets.data(), starts.data());
  for (std::size_t i = 0; i < frames * e; ++i) taken.get()[i] = static_cast<std::int64_t>(i % e);
  outcome = fit.run(fitted.get(), searched.get(), taken.get());
  State state(task);
  for (std::size_t t = 0; t < frames; ++t) {
    std::copy(fitted.get() + t * width, fitted.get() + (t + 1) * width, state.q.begin());
    forward(task.chain, state.q.data(), state.frames);
    measure(task, fit.targets(static_cast<int>(t)), state);
    std::copy(state.misses.begin(), state.misses.end(), misses.get() + t * e * PARTS);
  }
  return {std::move(fitted), std::move(misses), std::move(searched),
          std::move(taken),
          outcome.rounds, outcome.before, outcome.after};
}

Out<std::int64_t, 1> cheapest_ik_path(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                                      In<double, 3> paths, In<double, 2> costs,
                                      In<double, 2> drifts, In<double, 1> easy, bool open,
                                      bool closed) {
  const Chain chain = read_chain(nodes, numbers);
  const std::size_t count = paths.shape(0), length = paths.shape(1);
  const auto width = static_cast<std::size_t>(chain.coordinates);
  check::shape("paths", paths, {check::ANY, check::ANY, width});
  if (!count) check::refuse("paths", "the array is empty");
  check::shape("costs", costs, {count, length});
  check_steps("drifts", drifts, length, chain.dofs);
  check::shape("easy", easy, {std::max<std::size_t>(easy.shape(0), length ? length - 1 : 0)});
  Out<std::int64_t, 1> chosen(length);
  cheapest(chain, paths.data(), costs.data(), drifts.data(), easy.data(), count, length,
           open, closed, chosen.get());
  return chosen;
}

}  // namespace animtool
