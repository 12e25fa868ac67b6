// Solves problems of one rig in the rig's coordinates.
#include "ik/rig_solver.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "ik/closed.h"
#include "ik/extension.h"
#include "ik/read.h"
#include "ik/rig_map.h"
#include "ik/run.h"
#include "kinematics/coordinates.h"
#include "kinematics/kinematics.h"

namespace animtool {

using namespace ik;

namespace {

// Largest direction target; larger ones overflow when squared.
constexpr double MAX_DIRECTION = 1e100;

// Kinds of closed forms, numbered as in Python.
enum class ClosedKind { NONE = 0, LIMB = 1, ARM = 2 };

template <typename T, std::size_t N>
// Copies an array.
std::vector<T> to_vector(const In<T, N>& values) {
  return {values.data(), values.data() + values.size()};
}

// Copies of the rig's joint arrays, which outlive a call.
struct JointCopies {
  explicit JointCopies(const RigSolverArrays& inputs)
      : parents(to_vector(inputs.parents)),
        types(to_vector(inputs.types)),
        columns(to_vector(inputs.joint_columns)),
        axes(to_vector(inputs.axes)),
        translations(to_vector(inputs.rest_translations)),
        rotations(to_vector(inputs.rest_rotations)) {
    const JointArrays joints{inputs.types, inputs.joint_columns, inputs.axes,
                             inputs.rest_translations, inputs.rest_rotations};
    width = joints.check();
    check::shape("parents", inputs.parents, {types.size()});
  }

  JointArrays arrays() const {
    const std::size_t count = types.size();
    return {{types.data(), {count}},
            {columns.data(), {count}},
            {axes.data(), {count, 3}},
            {translations.data(), {count, 3}},
            {rotations.data(), {count, 4}}};
  }

  std::vector<std::int64_t> parents, types, columns;
  std::vector<double> axes, translations, rotations;
  std::size_t width;
};

RigMapArrays map_arrays(const RigSolverArrays& inputs) {
  return {inputs.columns,     inputs.scales, inputs.periods,      inputs.balls,
          inputs.ball_frames, inputs.mimics, inputs.mimic_numbers};
}

Settings solver_settings(const RigSolverArrays& inputs) {
  return {inputs.length_tolerance, inputs.angle_tolerance,
          inputs.damping,          inputs.iterations,
          inputs.restarts,         inputs.seed,
          inputs.seconds,          inputs.ordered && !inputs.warm};
}

}  // namespace

struct RigSolver::Problem {
  explicit Problem(const RigSolverArrays& inputs)
      : task(read_task(inputs.nodes, inputs.numbers, inputs.goals, inputs.goal_numbers,
                       inputs.rest_weight)),
        unstretched(task.chain),
        settings(checked_settings(solver_settings(inputs))),
        solver(make_solver(inputs.method, task, settings)),
        joints(inputs),
        rig_map(map_arrays(inputs), unstretched, joints.width),
        limbs(read_limbs(inputs.limbs, inputs.limb_numbers, task.goals.size())),
        goal_frames(to_vector(inputs.goal_frames)),
        length(inputs.length),
        is_sequential(inputs.ordered || inputs.warm),
        starts_from_previous(inputs.warm) {
    const std::size_t goal_count = task.goals.size();
    check::shape("goal_frames", inputs.goal_frames, {goal_count, 4});
    check::positive("length", length);
    check::shape("limb_joints", inputs.limb_joints, {check::ANY, 2});
    for (std::size_t i = 0; i < inputs.limb_joints.shape(0); ++i) {
      const std::int64_t* row = inputs.limb_joints.data() + 2 * i;
      check::indices("limb_joints", row, 1, 0, static_cast<std::int64_t>(joints.types.size()));
      check::indices("limb_joints", row + 1, 1, 0, static_cast<std::int64_t>(goal_count));
      limb_joints.emplace_back(row[0], row[1]);
    }
    build_closed_form(inputs.closed);
  }

  // Builds the closed form of a kind; checks that it fits the chain.
  void build_closed_form(int kind) {
    check::between("closed", kind, 0, static_cast<int>(ClosedKind::ARM));
    if (kind == static_cast<int>(ClosedKind::LIMB)) {
      const bool is_limb = unstretched.nodes.size() == 2 && task.goals.size() == 1 &&
                           unstretched.nodes[0].kind == Kind::BALL &&
                           unstretched.nodes[0].parent < 0 && unstretched.nodes[1].parent == 0 &&
                           unstretched.nodes[1].kind != Kind::SLIDE &&
                           unstretched.nodes[1].coordinate == 4 && unstretched.programs.empty();
      if (!is_limb) check::refuse("closed", "the chain is no limb of two bones");
      closed_form = make_limb(task);
    }
    if (kind == static_cast<int>(ClosedKind::ARM)) {
      std::unique_ptr<Arm> six_pin_arm =
          make_arm(task, settings.length_tolerance, settings.angle_tolerance);
      if (!six_pin_arm) check::refuse("closed", "the chain is no arm of six pins");
      arm = six_pin_arm.get();
      closed_form = std::move(six_pin_arm);
    }
  }

  // Converts targets of the rig to those of the chain.
  void pack_targets(const double* rig_targets, double* targets) const {
    std::copy(rig_targets, rig_targets + task.goals.size() * TARGET_WIDTH, targets);
    for (std::size_t e = 0; e < task.goals.size(); ++e) {
      const double* frame = goal_frames.data() + 4 * e;
      for_each_kind([&]<class Kind>(int component) {
        Kind::convert_target(targets + TARGET_WIDTH * e + TARGET_OFFSETS[component], frame, length);
      });
    }
  }

  // Checks targets in the world. Callers check them first, so that errors are reported in one
  // place.
  void check_world_targets(const char* name, std::size_t batch_size,
                           const In<double, 3>& targets) const {
    check_targets(name, task, batch_size, targets);
    check::finite(name, targets);
    for (std::size_t row = 0; row < batch_size * task.goals.size(); ++row)
      for_each_kind([&]<class Kind>(int component) {
        const double* values = targets.data() + TARGET_WIDTH * row + TARGET_OFFSETS[component];
        if (std::is_same_v<Kind, Position>) return;
        double largest = 0;
        for (int i = 0; i < Kind::TARGET_SIZE; ++i)
          largest = std::max(largest, std::fabs(values[i]));
        if (!(largest <= MAX_DIRECTION)) check::refuse(name, "a direction is beyond squares");
        if (Kind::TARGET_SIZE == 4 && !(largest > 0))
          check::refuse(name, "a rotation has no length");
      });
  }

  // Whether the errors of a goal are within the tolerances.
  bool is_reached(const double* errors) const {
    for (int component = 0; component < COMPONENT_COUNT; ++component)
      if (!(errors[component] <= settings.tolerance(component))) return false;
    return true;
  }

  // Computes the positions and linear frames of the rig's joints, with stretched bones.
  void compute_pose(const double* rig, const double* scales, double* positions,
                    double* linear_frames) {
    const std::size_t count = joints.types.size();
    translations.resize(3 * count), rotations.resize(4 * count);
    local_frame(joints.arrays(), rig, translations.data(), rotations.data());
    for (const auto& [joint, goal] : limb_joints)
      for (int i = 0; i < 3; ++i) translations[3 * joint + i] *= scales[goal];
    forward_kinematics({joints.parents.data(), {count}}, {translations.data(), {1, count, 3}},
                       {rotations.data(), {1, count, 4}}, std::nullopt, {positions, {1, count, 3}},
                       {linear_frames, {1, count, 3, 3}});
  }

  Task task;
  const Chain unstretched;
  const Settings settings;
  std::unique_ptr<Solver> solver;
  JointCopies joints;
  RigMap rig_map;
  std::vector<Limb> limbs;
  std::vector<std::pair<std::size_t, std::size_t>> limb_joints;
  std::vector<double> goal_frames;
  const double length;
  const bool is_sequential, starts_from_previous;
  std::unique_ptr<ClosedForm> closed_form;
  Arm* arm = nullptr;
  std::vector<double> translations, rotations;
};

RigSolver::RigSolver(const RigSolverArrays& inputs) : problem_(std::make_unique<Problem>(inputs)) {}

RigSolver::~RigSolver() = default;

RigSolveResult RigSolver::solve(In<double, 2> starts, In<double, 3> targets,
                                std::optional<In<double, 2>> preferred, bool returns_joint_poses) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Problem& problem = *problem_;
  const std::size_t batch_size = starts.shape(0), width = problem.joints.width;
  const std::size_t goal_count = problem.task.goals.size(),
                    chain_width = problem.unstretched.coordinate_count;
  const std::size_t joint_count = problem.joints.types.size();
  check::shape("starts", starts, {batch_size, width});
  check::finite("starts", starts);
  if (preferred) {
    check::shape("preferred", *preferred, {batch_size, width});
    check::finite("preferred", *preferred);
  }
  problem.check_world_targets("targets", batch_size, targets);
  Out<double, 2> coordinates(batch_size, width), scales(batch_size, goal_count);
  Out<double, 3> errors(batch_size, goal_count, COMPONENT_COUNT);
  Out<std::int64_t, 2> reports(batch_size, 3);
  Out<double, 1> seconds(batch_size);
  Out<bool, 2> reached_flags(batch_size, goal_count);
  Out<double, 3> positions(returns_joint_poses ? batch_size : 0, joint_count, 3);
  Out<double, 4> linear_frames(returns_joint_poses ? batch_size : 0, joint_count, 3, 3);
  std::vector<double> start(chain_width), rest(chain_width), solution(chain_width),
      previous(chain_width), previous_search(chain_width);
  std::vector<double> target(goal_count * TARGET_WIDTH), reachable(goal_count * TARGET_WIDTH);
  const std::unique_ptr<bool[]> is_softened(new bool[std::max<std::size_t>(goal_count, 1)]);
  bool has_previous = false;  // an earlier frame had goals; its pose is in `previous`
  bool has_search = false;    // an earlier frame needed a search; its pose is in `previous_search`
  for (std::size_t b = 0; b < batch_size; ++b) {
    double* error = errors.get() + b * goal_count * COMPONENT_COUNT;
    double* scale = scales.get() + b * goal_count;
    std::int64_t* report = reports.get() + 3 * b;
    double* rig = coordinates.get() + b * width;
    std::copy(starts.data() + b * width, starts.data() + (b + 1) * width, rig);
    problem.rig_map.to_chain(rig, start.data());
    if (preferred)
      problem.rig_map.to_chain(preferred->data() + b * width, rest.data());
    else
      rest = start;
    problem.pack_targets(targets.data() + b * goal_count * TARGET_WIDTH, target.data());
    extend_limbs(problem.limbs, goal_count, target.data(), reachable.data(), scale,
                 is_softened.get());
    const bool is_continued = problem.starts_from_previous && problem.closed_form &&
                              problem.closed_form->depends_on_start() && has_previous;
    const double* from = is_continued ? previous.data() : start.data();
    std::fill(report, report + 3, 0);
    seconds.get()[b] = 0;
    const bool is_closed_form =
        problem.closed_form && problem.closed_form->solve(from, target.data(), reachable.data(),
                                                          scale[0], solution.data(), error);
    if (!is_closed_form) {
      const bool is_next_frame = problem.is_sequential && has_search;
      if (problem.starts_from_previous && has_search && !is_continued)
        from = previous_search.data();
      RunResult run = run_one(*problem.solver, problem.unstretched, problem.task, from,
                              target.data(), reachable.data(), scale, rest.data(), is_next_frame);
      seconds.get()[b] = run.seconds;
      report[0] = static_cast<std::int64_t>(run.outcome.status);
      report[1] = run.outcome.iterations;
      report[2] = run.outcome.descent_count;
      const State& best = problem.solver->best();
      std::copy_n(run.outcome.status == Status::NOT_FINITE ? from : best.q.data(), chain_width,
                  solution.data());
      std::copy(best.errors.begin(), best.errors.end(), error);
      previous_search = solution;
      has_search = true;
    }
    // A limb without goals in a frame keeps its last pose.
    const bool is_without_goals = problem.closed_form && problem.starts_from_previous &&
                                  !count_active_rows(problem.task, target.data());
    if (!is_without_goals)
      previous = solution, has_previous = true;
    else if (has_previous)
      solution = previous;
    problem.rig_map.to_rig(solution.data(), rig);
    bool are_all_reached = true, are_all_softened = true;
    for (std::size_t e = 0; e < goal_count; ++e) {
      const bool is_goal_reached = problem.is_reached(error + COMPONENT_COUNT * e);
      reached_flags.get()[b * goal_count + e] = is_goal_reached;
      are_all_reached = are_all_reached && is_goal_reached;
      are_all_softened = are_all_softened && (is_goal_reached || is_softened[e]);
      for (int component = 0; component < COMPONENT_COUNT; ++component)
        if (IS_LENGTH[component]) error[COMPONENT_COUNT * e + component] *= problem.length;
    }
    // A target that was softened may have been too far away.
    if (report[0] == static_cast<std::int64_t>(Status::REACHED) && !are_all_reached)
      report[0] = static_cast<std::int64_t>(are_all_softened ? Status::SOFTENED : Status::NEAREST);
    if (returns_joint_poses)
      problem.compute_pose(rig, scale, positions.get() + 3 * b * joint_count,
                           linear_frames.get() + 9 * b * joint_count);
  }
  return {std::move(coordinates), std::move(errors),        std::move(reports),
          std::move(seconds),     std::move(reached_flags), std::move(scales),
          std::move(positions),   std::move(linear_frames)};
}

Out<double, 2> RigSolver::branches(In<double, 1> start, In<double, 2> targets) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Problem& problem = *problem_;
  if (!problem.arm) check::refuse("closed", "the chain is no arm of six pins");
  const std::size_t width = problem.joints.width, goal_count = problem.task.goals.size();
  check::shape("start", start, {width});
  check::shape("targets", targets, {goal_count, TARGET_WIDTH});
  check::finite("start", start);
  problem.check_world_targets("targets", 1, {targets.data(), {1, goal_count, TARGET_WIDTH}});
  std::vector<double> from(problem.unstretched.coordinate_count), target(goal_count * TARGET_WIDTH);
  double poses[MAX_BRANCHES * ARM_PINS];
  problem.rig_map.to_chain(start.data(), from.data());
  problem.pack_targets(targets.data(), target.data());
  const std::size_t count = problem.arm->branches(from.data(), target.data(), poses);
  Out<double, 2> coordinates(count, width);
  for (std::size_t i = 0; i < count; ++i) {
    double* rig = coordinates.get() + i * width;
    std::copy(start.data(), start.data() + width, rig);
    problem.rig_map.to_rig(poses + ARM_PINS * i, rig);
  }
  return coordinates;
}

int arm_kind(In<std::int64_t, 2> nodes, In<double, 2> numbers, In<std::int64_t, 2> goals,
             In<double, 2> goal_numbers, double rest_weight) {
  return static_cast<int>(
      ik::arm_kind(read_task(nodes, numbers, goals, goal_numbers, rest_weight)));
}

}  // namespace animtool
