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

// Larger direction targets overflow when squared.
constexpr double FARTHEST = 1e100;

// Closed forms, as Python numbers them.
enum class Closed { NONE = 0, LIMB = 1, ARM = 2 };

template <typename T, std::size_t N>
std::vector<T> copied(const In<T, N>& values) {
  return {values.data(), values.data() + values.size()};
}

// Arrays of the rig's joints that outlive a call.
struct JointMemory {
  explicit JointMemory(const RigSolverArrays& inputs)
      : parents(copied(inputs.parents)),
        types(copied(inputs.types)),
        columns(copied(inputs.joint_columns)),
        axes(copied(inputs.axes)),
        translations(copied(inputs.rest_translations)),
        rotations(copied(inputs.rest_rotations)) {
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

RigMapArrays map_of(const RigSolverArrays& inputs) {
  return {inputs.columns,     inputs.scales, inputs.periods,      inputs.balls,
          inputs.ball_frames, inputs.mimics, inputs.mimic_numbers};
}

Settings settings_of(const RigSolverArrays& inputs) {
  return {inputs.length_tolerance, inputs.angle_tolerance,
          inputs.damping,          inputs.iterations,
          inputs.restarts,         inputs.seed,
          inputs.seconds,          inputs.ordered && !inputs.warm};
}

}  // namespace

struct RigSolver::Parts {
  explicit Parts(const RigSolverArrays& inputs)
      : task(read_task(inputs.nodes, inputs.numbers, inputs.goals, inputs.goal_numbers,
                       inputs.rest_weight)),
        plain(task.chain),
        settings(checked_settings(settings_of(inputs))),
        solver(make_solver(inputs.method, task, settings)),
        joints(inputs),
        map(map_of(inputs), plain, joints.width),
        limbs(read_limbs(inputs.limbs, inputs.limb_numbers, task.goals.size())),
        goal_frames(copied(inputs.goal_frames)),
        length(inputs.length),
        ordered(inputs.ordered || inputs.warm),
        warm(inputs.warm) {
    const std::size_t goals = task.goals.size();
    check::shape("goal_frames", inputs.goal_frames, {goals, 4});
    check::positive("length", length);
    check::shape("limb_joints", inputs.limb_joints, {check::ANY, 2});
    for (std::size_t i = 0; i < inputs.limb_joints.shape(0); ++i) {
      const std::int64_t* row = inputs.limb_joints.data() + 2 * i;
      check::indices("limb_joints", row, 1, 0, static_cast<std::int64_t>(joints.types.size()));
      check::indices("limb_joints", row + 1, 1, 0, static_cast<std::int64_t>(goals));
      limb_joints.emplace_back(row[0], row[1]);
    }
    make_closed(inputs.closed);
  }

  void make_closed(int kind) {
    check::between("closed", kind, 0, static_cast<int>(Closed::ARM));
    if (kind == static_cast<int>(Closed::LIMB)) {
      const bool fits = plain.nodes.size() == 2 && task.goals.size() == 1 &&
                        plain.nodes[0].kind == Kind::BALL && plain.nodes[0].parent < 0 &&
                        plain.nodes[1].parent == 0 && plain.nodes[1].kind != Kind::SLIDE &&
                        plain.nodes[1].coordinate == 4 && plain.programs.empty();
      if (!fits) check::refuse("closed", "the chain is no limb of two bones");
      closed = make_limb(task);
    }
    if (kind == static_cast<int>(Closed::ARM)) {
      std::unique_ptr<Arm> six_pin_arm =
          make_arm(task, settings.length_tolerance, settings.angle_tolerance);
      if (!six_pin_arm) check::refuse("closed", "the chain is no arm of six pins");
      arm = six_pin_arm.get();
      closed = std::move(six_pin_arm);
    }
  }

  void pack_targets(const double* inputs, double* targets) const {
    std::copy(inputs, inputs + task.goals.size() * TARGET_WIDTH, targets);
    for (std::size_t e = 0; e < task.goals.size(); ++e) {
      const double* frame = goal_frames.data() + 4 * e;
      each_kind([&]<class Kind>(int part) {
        Kind::to_chain(targets + TARGET_WIDTH * e + COLUMNS[part], frame, length);
      });
    }
  }

  // Checks that callers make first, so that errors are reported in one place.
  void check_world(const char* name, std::size_t batch, const In<double, 3>& targets) const {
    check_targets(name, task, batch, targets);
    check::finite(name, targets);
    for (std::size_t row = 0; row < batch * task.goals.size(); ++row)
      each_kind([&]<class Kind>(int part) {
        const double* values = targets.data() + TARGET_WIDTH * row + COLUMNS[part];
        if (std::is_same_v<Kind, Position>) return;
        double most = 0;
        for (int i = 0; i < Kind::WIDTH; ++i) most = std::max(most, std::fabs(values[i]));
        if (!(most <= FARTHEST)) check::refuse(name, "a direction is beyond squares");
        if (Kind::WIDTH == 4 && !(most > 0)) check::refuse(name, "a rotation has no length");
      });
  }

  bool reaches(const double* errors) const {
    for (int part = 0; part < PARTS; ++part)
      if (!(errors[part] <= settings.tolerance(part))) return false;
    return true;
  }

  // Positions of the joints, with stretched bones.
  void pose(const double* rig, const double* scales, double* positions, double* linear) {
    const std::size_t count = joints.types.size();
    translations.resize(3 * count), rotations.resize(4 * count);
    local_frame(joints.arrays(), rig, translations.data(), rotations.data());
    for (const auto& [joint, goal] : limb_joints)
      for (int i = 0; i < 3; ++i) translations[3 * joint + i] *= scales[goal];
    forward_kinematics({joints.parents.data(), {count}}, {translations.data(), {1, count, 3}},
                       {rotations.data(), {1, count, 4}}, std::nullopt, {positions, {1, count, 3}},
                       {linear, {1, count, 3, 3}});
  }

  Task task;
  const Chain plain;
  const Settings settings;
  std::unique_ptr<Solver> solver;
  JointMemory joints;
  RigMap map;
  std::vector<Limb> limbs;
  std::vector<std::pair<std::size_t, std::size_t>> limb_joints;
  std::vector<double> goal_frames;
  const double length;
  const bool ordered, warm;
  std::unique_ptr<ClosedForm> closed;
  Arm* arm = nullptr;
  std::vector<double> translations, rotations;
};

RigSolver::RigSolver(const RigSolverArrays& inputs) : parts_(std::make_unique<Parts>(inputs)) {}

RigSolver::~RigSolver() = default;

RigSolved RigSolver::solve(In<double, 2> starts, In<double, 3> targets,
                           std::optional<In<double, 2>> preferred, bool placed) {
  const std::lock_guard<std::mutex> lock(busy_);
  Parts& parts = *parts_;
  const std::size_t batch = starts.shape(0), width = parts.joints.width;
  const std::size_t goals = parts.task.goals.size(), chain = parts.plain.coordinates;
  const std::size_t joints = parts.joints.types.size();
  check::shape("starts", starts, {batch, width});
  check::finite("starts", starts);
  if (preferred) {
    check::shape("preferred", *preferred, {batch, width});
    check::finite("preferred", *preferred);
  }
  parts.check_world("targets", batch, targets);
  Out<double, 2> coordinates(batch, width), scales(batch, goals);
  Out<double, 3> errors(batch, goals, PARTS);
  Out<std::int64_t, 2> reports(batch, 3);
  Out<double, 1> seconds(batch);
  Out<bool, 2> reached(batch, goals);
  Out<double, 3> positions(placed ? batch : 0, joints, 3);
  Out<double, 4> linear(placed ? batch : 0, joints, 3, 3);
  std::vector<double> start(chain), rest(chain), solved(chain), last(chain), searched(chain);
  std::vector<double> target(goals * TARGET_WIDTH), reachable(goals * TARGET_WIDTH);
  const std::unique_ptr<bool[]> softened(new bool[std::max<std::size_t>(goals, 1)]);
  bool has_last = false;      // there was a frame with goals, whose pose is in `last`
  bool has_searched = false;  // and a frame with a search, whose pose is in `searched`
  for (std::size_t b = 0; b < batch; ++b) {
    double* error = errors.get() + b * goals * PARTS;
    double* scale = scales.get() + b * goals;
    std::int64_t* report = reports.get() + 3 * b;
    double* rig = coordinates.get() + b * width;
    std::copy(starts.data() + b * width, starts.data() + (b + 1) * width, rig);
    parts.map.to_chain(rig, start.data());
    if (preferred)
      parts.map.to_chain(preferred->data() + b * width, rest.data());
    else
      rest = start;
    parts.pack_targets(targets.data() + b * goals * TARGET_WIDTH, target.data());
    extend(parts.limbs, goals, target.data(), reachable.data(), scale, softened.get());
    const bool continues = parts.warm && parts.closed && parts.closed->follows() && has_last;
    const double* from = continues ? last.data() : start.data();
    std::fill(report, report + 3, 0);
    seconds.get()[b] = 0;
    const bool closed = parts.closed && parts.closed->solve(from, target.data(), reachable.data(),
                                                            scale[0], solved.data(), error);
    if (!closed) {
      const bool next = parts.ordered && has_searched;
      if (parts.warm && has_searched && !continues) from = searched.data();
      Ran ran = run_one(*parts.solver, parts.plain, parts.task, from, target.data(),
                        reachable.data(), scale, rest.data(), next);
      seconds.get()[b] = ran.seconds;
      report[0] = static_cast<std::int64_t>(ran.outcome.status);
      report[1] = ran.outcome.iterations;
      report[2] = ran.outcome.descents;
      const State& best = parts.solver->best();
      std::copy_n(ran.outcome.status == Status::BROKEN ? from : best.q.data(), chain,
                  solved.data());
      std::copy(best.errors.begin(), best.errors.end(), error);
      searched = solved;
      has_searched = true;
    }
    // A limb without goals in a frame keeps its last pose.
    const bool idle = parts.closed && parts.warm && !rows_asked(parts.task, target.data());
    if (!idle)
      last = solved, has_last = true;
    else if (has_last)
      solved = last;
    parts.map.to_rig(solved.data(), rig);
    bool all = true, all_softened = true;
    for (std::size_t e = 0; e < goals; ++e) {
      const bool reaches = parts.reaches(error + PARTS * e);
      reached.get()[b * goals + e] = reaches;
      all = all && reaches;
      all_softened = all_softened && (reaches || softened[e]);
      for (int part = 0; part < PARTS; ++part)
        if (METRIC[part]) error[PARTS * e + part] *= parts.length;
    }
    // A target that was moved into reach may have been out of reach before.
    if (report[0] == static_cast<std::int64_t>(Status::REACHED) && !all)
      report[0] = static_cast<std::int64_t>(all_softened ? Status::SOFTENED : Status::NEAREST);
    if (placed)
      parts.pose(rig, scale, positions.get() + 3 * b * joints, linear.get() + 9 * b * joints);
  }
  return {std::move(coordinates), std::move(errors), std::move(reports),   std::move(seconds),
          std::move(reached),     std::move(scales), std::move(positions), std::move(linear)};
}

Out<double, 2> RigSolver::branches(In<double, 1> start, In<double, 2> targets) {
  const std::lock_guard<std::mutex> lock(busy_);
  Parts& parts = *parts_;
  if (!parts.arm) check::refuse("closed", "the chain is no arm of six pins");
  const std::size_t width = parts.joints.width, goals = parts.task.goals.size();
  check::shape("start", start, {width});
  check::shape("targets", targets, {goals, TARGET_WIDTH});
  check::finite("start", start);
  parts.check_world("targets", 1, {targets.data(), {1, goals, TARGET_WIDTH}});
  std::vector<double> from(parts.plain.coordinates), target(goals * TARGET_WIDTH);
  double poses[MAX_BRANCHES * ARM_PINS];
  parts.map.to_chain(start.data(), from.data());
  parts.pack_targets(targets.data(), target.data());
  const std::size_t count = parts.arm->branches(from.data(), target.data(), poses);
  Out<double, 2> coordinates(count, width);
  for (std::size_t i = 0; i < count; ++i) {
    double* rig = coordinates.get() + i * width;
    std::copy(start.data(), start.data() + width, rig);
    parts.map.to_rig(poses + ARM_PINS * i, rig);
  }
  return coordinates;
}

int arm_kind(In<std::int64_t, 2> nodes, In<double, 2> numbers, In<std::int64_t, 2> goals,
             In<double, 2> goal_numbers, double rest_weight) {
  return static_cast<int>(
      ik::arm_kind(read_task(nodes, numbers, goals, goal_numbers, rest_weight)));
}

}  // namespace animtool
