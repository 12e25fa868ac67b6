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
constexpr std::size_t GOAL_NUMBERS = 9 + COMPONENT_COUNT;

// Checks that frames and gains are finite; limits, which may be infinite, must be in order.
void check_node_numbers(const Node& node, const double* values) {
  check::finite("numbers", values, 14);
  const double* limit = values + 14;
  const bool is_ball = node.kind == Kind::BALL;
  const bool is_in_order =
      is_ball ? limit[0] >= 0 && limit[1] >= 0 && limit[2] <= limit[3] : limit[0] <= limit[1];
  if (!is_in_order) check::refuse("numbers", "limits are not in order");
}

// Rows after those of the nodes contain the instructions of programs: 3, index of the program,
// operation, and 1 plus the index of the coordinate or program, or plus the count, that the
// operation needs.
constexpr std::int64_t INSTRUCTION_ROW = 3;
// Driver kind of a node, in its last column, if its value is that of a program.
constexpr std::int64_t FOLLOWS_PROGRAM = 2;
// Number of collected degrees of freedom above which duplicates are removed.
constexpr std::size_t MAX_COLLECTED_DOFS = 4 * MAX_SLOPES;

// Collects the degrees of freedom that a program depends on, by its coordinates and by other
// programs.
void add_dofs(const Chain& chain, const std::vector<int>& dof_by_coordinate, Program& program) {
  for (const Instruction& instruction : program.instructions) {
    if (instruction.op == Op::COORDINATE)
      program.dofs.push_back(dof_by_coordinate[instruction.index]);
    if (instruction.op == Op::BALL)
      for (int k = 0; k < 3; ++k) program.dofs.push_back(dof_by_coordinate[instruction.index] + k);
    if (instruction.op == Op::RESULT) {
      const std::vector<int>& other_dofs = chain.programs[instruction.index].dofs;
      program.dofs.insert(program.dofs.end(), other_dofs.begin(), other_dofs.end());
    }
    if (program.dofs.size() > MAX_COLLECTED_DOFS) {
      std::sort(program.dofs.begin(), program.dofs.end());
      program.dofs.erase(std::unique(program.dofs.begin(), program.dofs.end()), program.dofs.end());
      if (program.dofs.size() > MAX_SLOPES) check::refuse("nodes", "a program reads too much");
    }
  }
  std::sort(program.dofs.begin(), program.dofs.end());
  program.dofs.erase(std::unique(program.dofs.begin(), program.dofs.end()), program.dofs.end());
  for (Instruction& instruction : program.instructions)
    if (instruction.op == Op::COORDINATE || instruction.op == Op::BALL) {
      const auto entry = std::lower_bound(program.dofs.begin(), program.dofs.end(),
                                          dof_by_coordinate[instruction.index]);
      instruction.first_slot = static_cast<int>(entry - program.dofs.begin());
    }
}

// Simulates the stack of a program: one value must remain, and no instruction may lack operands.
void check_stack(Program& program) {
  std::size_t stack_size = 0;
  int point_count = 0;
  for (const Instruction& instruction : program.instructions) {
    if (instruction.op == Op::POINT) {
      ++point_count;
      continue;
    }
    if (point_count != (instruction.op == Op::CURVE ? instruction.index : 0) ||
        (instruction.op == Op::CURVE && !point_count))
      check::refuse("nodes", "a curve of a program has other points");
    point_count = 0;
    const std::size_t operand_count = count_operands(instruction.op);
    if (stack_size < operand_count) check::refuse("nodes", "a program takes what is not there");
    stack_size += 1 - operand_count;
    program.depth = std::max(program.depth, stack_size);
  }
  if (stack_size != 1 || point_count || program.depth > MAX_STACK_DEPTH)
    check::refuse("nodes", "a program does not come to one value");
}

// Reads the programs from the rows from `first`. `is_ball` tells for each coordinate whether it is
// the first of a ball.
void read_programs(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers,
                   std::size_t first_row, const std::vector<int>& dof_by_coordinate,
                   const std::vector<bool>& is_ball, Chain& chain) {
  const std::int64_t coordinates = chain.coordinate_count;
  std::size_t slope_count = 0;
  for (std::size_t n = first_row; n < nodes.shape(0);) {
    Program program;
    const auto program_index = static_cast<std::int64_t>(chain.programs.size());
    for (; n < nodes.shape(0) && nodes.data()[4 * n + 1] == program_index; ++n) {
      const std::int64_t* row = nodes.data() + 4 * n;
      check::between("nodes", row[0], INSTRUCTION_ROW, INSTRUCTION_ROW);
      check::between("nodes", row[2], 0, static_cast<std::int64_t>(Op::COUNT) - 1);
      check::finite("numbers", numbers.data() + 18 * n, MAX_NUMBERS);
      check::between("nodes", row[3], 1, static_cast<std::int64_t>(check::MAX_ROWS));
      const std::int64_t index_plus_one = row[3] - 1;
      Instruction instruction{static_cast<Op>(row[2]), 0, {}, 0};
      std::copy(numbers.data() + 18 * n, numbers.data() + 18 * n + MAX_NUMBERS,
                instruction.numbers);
      if (instruction.op == Op::COORDINATE || instruction.op == Op::BALL) {
        check::indices("nodes", &index_plus_one, 1, 1, coordinates + 1);
        if (is_ball[index_plus_one - 1] != (instruction.op == Op::BALL) ||
            dof_by_coordinate[index_plus_one - 1] < 0)
          check::refuse("nodes", "a program reads no such coordinate");
      }
      if (instruction.op == Op::RESULT)
        check::indices("nodes", &index_plus_one, 1, 1, program_index + 1);
      if (instruction.op == Op::CURVE)
        check::indices("nodes", &index_plus_one, 1, 1, check::MAX_ROWS);
      instruction.index =
          static_cast<int>(instruction.op == Op::CURVE ? index_plus_one : index_plus_one - 1);
      program.instructions.push_back(instruction);
    }
    if (program.instructions.empty()) check::refuse("nodes", "programs are out of order");
    check_stack(program);
    add_dofs(chain, dof_by_coordinate, program);
    program.first_slope = slope_count;
    slope_count += program.dofs.size();
    chain.programs.push_back(std::move(program));
  }
}

}  // namespace

Chain read_chain(const In<std::int64_t, 2>& nodes, const In<double, 2>& numbers) {
  check::shape("nodes", nodes, {check::ANY, 4});
  check::shape("numbers", numbers, {nodes.shape(0), 18});
  check::at_most("nodes", nodes.shape(0), check::MAX_ROWS);
  Chain chain;
  int next_coordinate = 0, next_dof = 0;
  std::vector<int> dof_by_coordinate;
  std::vector<bool> is_ball;
  std::size_t node_count = 0;
  while (node_count < nodes.shape(0) && nodes.data()[4 * node_count] != INSTRUCTION_ROW)
    ++node_count;
  for (std::size_t n = 0; n < node_count; ++n) {
    const std::int64_t* row = nodes.data() + 4 * n;
    const double* values = numbers.data() + 18 * n;
    Node node{};
    node.program = -1;
    check::between("nodes", row[0], 0, static_cast<std::int64_t>(Kind::BALL));
    check::between("nodes", row[1], -1, static_cast<std::int64_t>(n) - 1);
    node.kind = static_cast<Kind>(row[0]);
    check_node_numbers(node, values);
    node.parent = static_cast<int>(row[1]);
    node.is_driven = row[3] != 0;
    std::copy(values, values + 9, node.rest);
    std::copy(values + 9, values + 12, node.offset);
    node.gain = values[12], node.shift = values[13];
    std::copy(values + 14, values + 18, node.limit);
    if (node.kind == Kind::BALL) set_inside_bounds(node);
    if (row[3] == FOLLOWS_PROGRAM) {
      check::between("nodes", row[2], 0, check::MAX_ROWS);
      if (node.kind == Kind::BALL) check::refuse("nodes", "a ball follows no program");
      node.program = static_cast<int>(row[2]);
      chain.nodes.push_back(node);
      continue;
    }
    node.coordinate = static_cast<int>(row[2]);
    if (node.is_driven) {
      check::indices("nodes", row + 2, 1, 0, next_coordinate);
      if (node.kind == Kind::BALL || is_ball[row[2]] || dof_by_coordinate[row[2]] < 0)
        check::refuse("nodes", "coordinate " + check::text(row[2]) + " is none to follow");
      node.dof = dof_by_coordinate[row[2]];
    } else {
      check::between("nodes", row[2], next_coordinate, next_coordinate);
      const int coordinate_count = node.kind == Kind::BALL ? 4 : 1;
      node.dof = next_dof;
      dof_by_coordinate.insert(dof_by_coordinate.end(), coordinate_count, -1);
      is_ball.insert(is_ball.end(), coordinate_count, false);
      dof_by_coordinate[next_coordinate] = next_dof;
      is_ball[next_coordinate] = node.kind == Kind::BALL;
      next_coordinate += coordinate_count;
      next_dof += node.dof_count();
    }
    chain.nodes.push_back(node);
  }
  chain.coordinate_count = next_coordinate;
  chain.dof_count = next_dof;
  read_programs(nodes, numbers, node_count, dof_by_coordinate, is_ball, chain);
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
  check::non_negative("rest_weight", rest_weight);
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
    for (int component = 0; component < COMPONENT_COUNT; ++component)
      check::non_negative("goal_numbers", values[9 + component]);
    Goal goal;
    goal.node = static_cast<int>(row[0]);
    goal.root = static_cast<int>(row[1]);
    goal.middle = static_cast<int>(row[2]);
    std::copy(values, values + 3, goal.stretching_offset);
    std::copy(values + 3, values + 6, goal.fixed_offset);
    for (int i = 0; i < 3; ++i) goal.offset[i] = goal.stretching_offset[i] + goal.fixed_offset[i];
    std::copy(values + 6, values + 9, goal.aim_axis);
    std::copy(values + 9, values + GOAL_NUMBERS, goal.weights);
    goal.level = static_cast<int>(row[3]);
    task.level_count = std::max(task.level_count, goal.level + 1);
    for_each_kind([&]<class Kind>(int component) {
      if (Kind::NEEDS_LIMB && goal.weights[component] > 0 && (row[1] < 0 || row[2] < 0))
        check::refuse("goals", "goal " + check::text(e) + " has a " + Kind::NAME + " and no limb");
    });
    goal.row = task.row_count;
    for (int n = goal.node; n >= 0; n = task.chain.nodes[n].parent) goal.path.push_back(n);
    std::reverse(goal.path.begin(), goal.path.end());
    task.row_count += count_rows(goal);
    task.goals.push_back(goal);
  }
  return task;
}

void check_poses(const char* name, const Task& task, std::size_t batch_size,
                 const In<double, 2>& poses) {
  check::shape(name, poses, {batch_size, static_cast<std::size_t>(task.chain.coordinate_count)});
}

void check_targets(const char* name, const Task& task, std::size_t batch_size,
                   const In<double, 3>& targets) {
  check::shape(name, targets, {batch_size, task.goals.size(), TARGET_WIDTH});
  for (std::size_t row = 0; row < batch_size * task.goals.size(); ++row)
    for (int component = 0; component < COMPONENT_COUNT; ++component) {
      const double factor = targets.data()[TARGET_WIDTH * row + WEIGHTS_OFFSET + component];
      if (!(factor >= 0))
        check::refuse(name, "the share " + check::text(factor) + " is not 0 or more");
    }
}

void check_tolerances(double length, double angle, double damping) {
  check::non_negative("length_tolerance", length);
  check::non_negative("angle_tolerance", angle);
  check::non_negative("damping", damping);
}

void check_steps(const char* name, const In<double, 2>& steps, std::size_t frames, int dofs) {
  const std::size_t count = std::max<std::size_t>(steps.shape(0), frames ? frames - 1 : 0);
  check::shape(name, steps, {count, static_cast<std::size_t>(dofs)});
}

}  // namespace animtool::ik
