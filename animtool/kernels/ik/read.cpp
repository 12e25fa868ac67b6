// Builds the chain and the task from the arrays of a problem.
#include "ik/read.h"

#include <algorithm>
#include <cmath>

#include "ik/limits.h"

namespace animtool::ik {

namespace {

// Matrices over the rows are indexed with int.
constexpr std::size_t MAX_GOALS = 46340 / MAX_GOAL_ROWS;
// Numbers of a goal: both parts of its offset, its aim axis, and its weights.
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
// Value of a node's `follows` column if its coordinate is a program.
constexpr std::int64_t FOLLOWS_PROGRAM = 2;
// Degrees of freedom that are gathered before doubles are taken out.
constexpr std::size_t MAX_ROWS_READ = 4 * MAX_SLOPES;

// Degrees of freedom that a program depends on: of its coordinates, and of other programs.
void add_dofs(const Chain& chain, const std::vector<int>& dof_of, Program& program) {
  for (const Instruction& one : program.instructions) {
    if (one.op == Op::COORDINATE) program.dofs.push_back(dof_of[one.which]);
    if (one.op == Op::BALL)
      for (int k = 0; k < 3; ++k) program.dofs.push_back(dof_of[one.which] + k);
    if (one.op == Op::RESULT) {
      const std::vector<int>& others = chain.programs[one.which].dofs;
      program.dofs.insert(program.dofs.end(), others.begin(), others.end());
    }
    if (program.dofs.size() > MAX_ROWS_READ) {
      std::sort(program.dofs.begin(), program.dofs.end());
      program.dofs.erase(std::unique(program.dofs.begin(), program.dofs.end()), program.dofs.end());
      if (program.dofs.size() > MAX_SLOPES) check::refuse("nodes", "a program reads too much");
    }
  }
  std::sort(program.dofs.begin(), program.dofs.end());
  program.dofs.erase(std::unique(program.dofs.begin(), program.dofs.end()), program.dofs.end());
  for (Instruction& one : program.instructions)
    if (one.op == Op::COORDINATE || one.op == Op::BALL) {
      const auto position =
          std::lower_bound(program.dofs.begin(), program.dofs.end(), dof_of[one.which]);
      one.slot = static_cast<int>(position - program.dofs.begin());
    }
}

// Simulates the stack: one value remains, and no instruction lacks operands.
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
    const std::size_t operand_count = arguments(one.op);
    if (stacked < operand_count) check::refuse("nodes", "a program takes what is not there");
    stacked += 1 - operand_count;
    program.depth = std::max(program.depth, stacked);
  }
  if (stacked != 1 || points || program.depth > MAX_STACKED)
    check::refuse("nodes", "a program does not come to one value");
}

// `balls`: for each coordinate, whether it is the first of a ball.
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
      check::finite("numbers", numbers.data() + 18 * n, MAX_NUMBERS);
      check::between("nodes", row[3], 1, static_cast<std::int64_t>(check::MAX_ROWS));
      const std::int64_t which = row[3] - 1;
      Instruction one{static_cast<Op>(row[2]), 0, {}, 0};
      std::copy(numbers.data() + 18 * n, numbers.data() + 18 * n + MAX_NUMBERS, one.numbers);
      if (one.op == Op::COORDINATE || one.op == Op::BALL) {
        check::indices("nodes", &which, 1, 1, coordinates + 1);
        if (balls[which - 1] != (one.op == Op::BALL) || dof_of[which - 1] < 0)
          check::refuse("nodes", "a program reads no such coordinate");
      }
      if (one.op == Op::RESULT) check::indices("nodes", &which, 1, 1, number + 1);
      if (one.op == Op::CURVE) check::indices("nodes", &which, 1, 1, check::MAX_ROWS);
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

}  // namespace

Chain read_chain(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers) {
  check::shape("nodes", nodes, {check::ANY, 4});
  check::shape("numbers", numbers, {nodes.shape(0), 18});
  check::at_most("nodes", nodes.shape(0), check::MAX_ROWS);
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
      check::between("nodes", row[2], 0, check::MAX_ROWS);
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
  check::at_most("goals", goals.shape(0), MAX_GOALS);
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
    for (int part = 0; part < PARTS; ++part) check::not_negative("goal_numbers", values[9 + part]);
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

void check_poses(const char* name, const Task& task, std::size_t batch,
                 const In<double, 2>& poses) {
  check::shape(name, poses, {batch, static_cast<std::size_t>(task.chain.coordinates)});
}

void check_targets(const char* name, const Task& task, std::size_t batch,
                   const In<double, 3>& targets) {
  check::shape(name, targets, {batch, task.goals.size(), TARGET_WIDTH});
  for (std::size_t row = 0; row < batch * task.goals.size(); ++row)
    for (int part = 0; part < PARTS; ++part) {
      const double by = targets.data()[TARGET_WIDTH * row + WEIGHTS + part];
      if (!(by >= 0)) check::refuse(name, "the share " + check::text(by) + " is not 0 or more");
    }
}

void check_tolerances(double length, double angle, double damping) {
  check::not_negative("length_tolerance", length);
  check::not_negative("angle_tolerance", angle);
  check::not_negative("damping", damping);
}

void check_steps(const char* name, const In<double, 2>& steps, std::size_t frames, int dofs) {
  const std::size_t count = std::max<std::size_t>(steps.shape(0), frames ? frames - 1 : 0);
  check::shape(name, steps, {count, static_cast<std::size_t>(dofs)});
}

}  // namespace animtool::ik
