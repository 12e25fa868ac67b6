// Smooths a path of poses within limits; the points of its goals stay fixed.
//
// Minimises over all frames at once: sum |q - anchor|^2 + speed |v|^2 + acceleration |a|^2, by
// Gauss-Newton with steps in the null space of the goals' Jacobians. Differences of balls are
// rotation vectors. With the projections Pi onto that null space, and the same scalar matrix P of
// five diagonals for every degree of freedom, Pi P Pi x = Pi b is solved by conjugate gradients
// with the preconditioner Pi P^-1 Pi. It is exact where Pi is constant in time, or changes only
// because of limits: P^-1 is over the steps that these allow (N. Gould, M. Hribar, J. Nocedal, On
// the solution of equality constrained quadratic programming problems arising in optimization,
// 2001, algorithm 2.1).
#include "ik/solve.h"

#include "ik/goals.h"
#include "ik/levels.h"
#include "ik/limit_band.h"
#include "ik/path_cost.h"
#include "ik/read.h"
#include "ik/space.h"

namespace animtool {

namespace ik {

namespace {

struct PathSettings {
  PathWeights weights;
  int first, end;  // range of frames that may change
  int iterations;  // largest number of Gauss-Newton iterations
};

// Number of iterations, and the cost before and after them.
struct PathOutcome {
  int iterations = 0;
  double start_cost = 0, end_cost = 0;
};

class PathSmoother {
 public:
  // `stretch_factors` (F, E) are factors of the limbs' bone lengths; `drifts` (F - 1, D) is the
  // motion between frames that costs nothing.
  PathSmoother(const Task& task, const Settings& settings, const PathSettings& path, int frames,
               const double* targets, const double* stretch_factors, const double* drifts)
      : task_(without_preferences(task)),
        unstretched_(task_.chain),
        settings_(settings),
        tight_settings_(tighten_tolerances(settings)),
        path_(path),
        frame_count_(frames),
        dof_count_(task.chain.dof_count),
        coordinate_count_(task.chain.coordinate_count),
        first_(path.first),
        end_(path.end),
        targets_(targets, targets + frames * task.goals.size() * TARGET_WIDTH),
        stretch_factors_(stretch_factors),
        cost_(task_.chain, frames, path.weights, drifts),
        band_(frames, path.first, path.end, path.weights),
        search_(task_, tight_settings_),
        stepper_(task_),
        state_(task_),
        linear_(task_),
        goal_spaces_(frames),
        is_frozen_(frames, 0),
        tangent_(dof_count_) {}

  // Improves a path (F, Q) in place.
  PathOutcome run(double* path) {
    current_path_.assign(path, path + static_cast<std::size_t>(frame_count_) * coordinate_count_);
    anchors_ = current_path_;
    for (int t = 0; t < frame_count_; ++t) freeze_missed_goals(t);
    PathOutcome outcome;
    outcome.start_cost = evaluate_all();
    std::vector<char> was_corner(frame_count_, 0);
    minimize(outcome, outcome.start_cost);
    if (path_.weights.acceleration > 0 && path_.iterations > 0)
      for (int i = 0; i < MAX_CORNERS && select_corner(was_corner); ++i) {
        minimize(outcome, local_cost());
        shift_corner(outcome);
      }
    outcome.end_cost = evaluate_all();
    std::copy(current_path_.begin(), current_path_.end(), path);
    return outcome;
  }

 private:
  // Goals are restored to this fraction of their tolerance, in at most this many steps.
  static constexpr double TOLERANCE_FRACTION = 1e-2;
  static constexpr int RESTORE_STEPS = 30;
  // An iteration with a smaller relative gain is the last one.
  static constexpr double MIN_RELATIVE_GAIN = 1e-2;
  // Largest number of corners that are smoothed separately.
  static constexpr int MAX_CORNERS = 8;
  // A frame is a corner if it costs this many times the median of the frames around it. Corners are
  // shifted in time, earlier and later, in steps of this many frames, this many times.
  static constexpr double CORNER_RATIO = 10, SHIFT_STEP_FRAMES = 0.5;
  static constexpr int MAX_CORNER_SHIFTS = 8;
  // Largest number of attempts of a step, and the factor of the damping between them.
  static constexpr int MAX_ATTEMPTS = 8;
  static constexpr double DAMPING_FACTOR = 4;
  // Passes over the limits, steps of conjugate gradients, and their tolerances.
  static constexpr int LIMIT_PASSES = 5, MAX_CG_STEPS = 60;
  static constexpr double CG_TOLERANCE = 1e-2, FIRST_CG_TOLERANCE = 3e-1;

  // Removes preferences and priorities: goals keep their values, even if they yielded to other
  // goals or to a preference.
  static Task without_preferences(Task task) {
    task.rest_weight = 0;
    task.level_count = 1;
    return task;
  }

  static Settings tighten_tolerances(Settings settings) {
    settings.length_tolerance *= TOLERANCE_FRACTION;
    settings.angle_tolerance *= TOLERANCE_FRACTION;
    settings.iterations = RESTORE_STEPS;
    settings.restarts = 0;
    return settings;
  }

  double* target(int t) {
    return targets_.data() + static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }

  double* frame(std::vector<double>& rows, int t) {
    return rows.data() + static_cast<std::size_t>(t) * dof_count_;
  }

  double* pose(std::vector<double>& path, int t) {
    return path.data() + static_cast<std::size_t>(t) * coordinate_count_;
  }

  void stretch_frame(int t) {
    stretch_limbs(unstretched_, stretch_factors_ + t * task_.goals.size(), task_);
  }

  // Corrects a pose so that it reaches the goals of a frame; returns whether it does.
  bool restore_goals(int t, const double* start) {
    stretch_frame(t);
    if (search_.run(start, target(t), start, false) == Status::NOT_FINITE) return false;
    const State& best = search_.best();
    std::copy(best.q.begin(), best.q.end(), pose(next_path_, t));
    return is_reached(best);
  }

  // Sets state_ to the pose of a frame.
  void load_frame(int t) {
    stretch_frame(t);
    const double* q = pose(current_path_, t);
    std::copy(q, q + coordinate_count_, state_.q.begin());
    compute_frames(task_.chain, state_.q.data(), state_.frames);
    measure(task_, target(t), state_);
    // A goal is preserved even if its weight is small.
    for (double& weight : state_.weights) weight = weight > 0 ? 1 : 0;
  }

  bool is_reached(const State& state) const {
    for (std::size_t i = 0; i < state.errors.size(); ++i)
      if (!(state.errors[i] <= settings_.tolerance(static_cast<int>(i % COMPONENT_COUNT))))
        return false;
    return true;
  }

  // If a frame misses its goals, their current values become the targets.
  void freeze_missed_goals(int t) {
    load_frame(t);
    if (is_reached(state_)) return;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      double* reached_target = target(t) + TARGET_WIDTH * e;
      const GoalView view = view_of(goal, state_, &state_.points[3 * e]);
      for_each_kind([&]<class Kind>(int component) {
        if (!Kind::NEEDS_LIMB || goal.middle >= 0)
          Kind::target_from_pose(view, reached_target + TARGET_OFFSETS[component]);
      });
    }
  }

  // Iterates over the frames from first_ to end_ until the gain is small relative to `scale`.
  void minimize(PathOutcome& outcome, double scale) {
    damping_ = 0;
    double cost = evaluate(current_path_);
    for (int iteration = 0; iteration < path_.iterations; ++iteration) {
      const double next_cost = advance(cost);
      if (!(next_cost < cost)) return;
      ++outcome.iterations;
      const bool has_converged = cost - next_cost < MIN_RELATIVE_GAIN * scale;
      cost = next_cost;
      if (has_converged) return;
    }
  }

  // Selects the frames around the sharpest remaining corner: others have converged, and must not
  // limit the length of steps.
  bool select_corner(std::vector<char>& was_corner) {
    evaluate_all();
    int sharpest = -1;
    for (int t = path_.first; t < path_.end; ++t)
      if (!was_corner[t] && (sharpest < 0 || cost_.frame_costs[t] > cost_.frame_costs[sharpest]))
        sharpest = t;
    if (sharpest < 0) return false;
    const double time_scale = std::sqrt(std::sqrt(path_.weights.acceleration));
    const int range = static_cast<int>(std::clamp(2 * time_scale, 8.0, 60.0));
    first_ = std::max(sharpest - range, path_.first);
    end_ = std::min(sharpest + range + 1, path_.end);
    std::fill(was_corner.begin() + std::max(sharpest - range / 2, 0),
              was_corner.begin() + std::min(sharpest + range / 2 + 1, frame_count_), 1);
    std::fill(is_frozen_.begin(), is_frozen_.end(), 0);
    band_ = TimeBand(frame_count_, first_, end_, path_.weights);
    return true;
  }

  // A path that passes near a singular pose has a corner that no small change removes. It can be
  // smooth only if it passes the pose at another time, so other times are tried.
  void shift_corner(PathOutcome& outcome) {
    for (const double width : {1.0, 0.5})
      for (int attempt = 0; attempt < 2 * MAX_CORNER_SHIFTS; ++attempt) {
        if (!has_corner()) return;
        const double frame_shift = (attempt / 2 + 1) * SHIFT_STEP_FRAMES * (attempt % 2 ? -1 : 1);
        const double cost = evaluate(current_path_);
        const std::vector<double> previous_path = current_path_;
        if (shift_frames(frame_shift, width)) minimize(outcome, local_cost());
        if (!(evaluate(current_path_) < cost)) current_path_ = previous_path;
      }
    evaluate(current_path_);
  }

  // Whether a frame of the current range is a corner.
  bool has_corner() {
    evaluate(current_path_);
    const auto largest =
        std::max_element(cost_.frame_costs.begin() + first_, cost_.frame_costs.begin() + end_);
    std::vector<double> costs(cost_.frame_costs.begin() + first_, cost_.frame_costs.begin() + end_);
    std::nth_element(costs.begin(), costs.begin() + costs.size() / 2, costs.end());
    return *largest > CORNER_RATIO * costs[costs.size() / 2];
  }

  // Shifts the current frames in time, the middle ones most, and restores their goals. Returns
  // false if a frame cannot be restored.
  bool shift_frames(double frame_shift, double width) {
    const double middle = (first_ + end_ - 1) / 2.0, half_range = width * (end_ - first_ + 1) / 2.0;
    next_path_ = current_path_;
    step_.resize(gradient_.size());
    for (int t = first_; t < end_; ++t) {
      const double relative_distance = std::fabs(t - middle) / half_range;
      if (relative_distance >= 1) continue;
      const double weight = std::cos(relative_distance * REVOLUTION / 4);
      const double time = std::clamp(t + frame_shift * weight * weight, 0.0, frame_count_ - 1.0);
      const int frame_before = std::min(static_cast<int>(time), frame_count_ - 2);
      difference(task_.chain, pose(current_path_, frame_before),
                 pose(current_path_, frame_before + 1), tangent_.data());
      for (double& x : tangent_) x *= time - frame_before;
      stepped_pose_.resize(coordinate_count_);
      stepper_.move(pose(current_path_, frame_before), tangent_.data(), stepped_pose_.data());
      if (!restore_goals(t, stepped_pose_.data())) return false;
    }
    current_path_.swap(next_path_);
    return true;
  }

  // Cost of the acceleration of the current frames.
  double local_cost() const {
    double cost = 0;
    for (int t = first_; t < end_; ++t) cost += cost_.frame_costs[t];
    return cost;
  }

  double evaluate_all() { return cost_.evaluate(anchors_.data(), current_path_.data()); }

  // Cost of the terms that depend on the current frames.
  double evaluate(const std::vector<double>& q, std::vector<double>* gradient = nullptr) {
    return cost_.evaluate(anchors_.data(), q.data(), gradient, first_, end_);
  }

  // Makes one iteration; returns the cost after it. A step that is too long is repeated with more
  // damping.
  double advance(double cost) {
    evaluate(current_path_, &gradient_);
    for (int i = 0; i < MAX_ATTEMPTS; ++i) {
      const double curvature = solve_step();
      if (max_component() < MAX_ROTATION && apply_step(i + 1 < MAX_ATTEMPTS)) {
        const double next_cost = evaluate(next_path_);
        if (next_cost < cost) {
          current_path_.swap(next_path_);
          damping_ /= DAMPING_FACTOR;
          return next_cost;
        }
      }
      damping_ = DAMPING_FACTOR * std::max(damping_, curvature);
    }
    return cost;
  }

  // Computes step_, the best step within the limits; returns the curvature of the damped cost
  // along it.
  double solve_step() {
    band_.set_damping(damping_);
    step_.assign(gradient_.size(), 0.0);
    for (int t = first_; t < end_; ++t) linearize_frame(t);
    // Limits that the path runs into are visible in rough steps already.
    bool uses_tight_tolerance = false;
    for (int pass = 0; pass < LIMIT_PASSES; ++pass) {
      uses_tight_tolerance = uses_tight_tolerance || pass + 1 == LIMIT_PASSES;
      solve(uses_tight_tolerance ? CG_TOLERANCE : FIRST_CG_TOLERANCE, pass == 0);
      if (fix_violations()) continue;
      if (uses_tight_tolerance) break;
      uses_tight_tolerance = true;
    }
    band_.multiply(step_, dof_count_, product_);
    double quadratic_form = 0, squared_length = 1e-300;
    for (std::size_t i = range_begin(); i < range_end(); ++i)
      quadratic_form += step_[i] * product_[i], squared_length += step_[i] * step_[i];
    return quadratic_form / squared_length;
  }

  double max_component() const {
    double largest = 0;
    for (const double x : step_) largest = std::max(largest, std::fabs(x));
    return largest;
  }

  // Computes the locked limits, and the null space of the goals, at the pose of a frame.
  void linearize_frame(int t) {
    load_frame(t);
    stepper_.fix_locked(state_, goal_spaces_[t].fixed_directions, goal_spaces_[t].limit_flags);
    update_null_space(t);
  }

  void update_null_space(int t) {
    differentiate(task_, target(t), state_, linear_.columns);
    goal_spaces_[t].update_null_space(task_.row_count, dof_count_, linear_.columns, buffers_);
  }

  // Projects a frame of x onto the null space of goals and limits.
  void project(std::vector<double>& x, int t) {
    double* values = frame(x, t);
    if (is_frozen_[t])
      std::fill(values, values + dof_count_, 0.0);
    else
      goal_spaces_[t].project(values, buffers_);
  }

  // Computes step_, the best step that goals and fixed limits allow, starting from the previous
  // one.
  void solve(double tolerance, bool is_first) {
    const std::size_t length = gradient_.size();
    const auto fixed_of = [&](int t) -> const std::vector<FixedDirection>& {
      return goal_spaces_[t].fixed_directions;
    };
    pin_band_.factor(band_, first_, end_, fixed_of),
        ball_band_.factor(band_, first_, end_, fixed_of);
    for (int t = first_; t < end_; ++t) project(step_, t);
    for (int t = first_; t < end_; ++t) {
      if (is_frozen_[t]) continue;
      double* values = frame(step_, t);
      for (int d = 0; d < dof_count_; ++d) values[d] += goal_spaces_[t].step[d];
    }
    product_.assign(length, 0.0);
    band_.multiply(step_, dof_count_, product_);
    residual_.assign(length, 0.0);
    preconditioned_residual_.assign(length, 0.0);
    for (std::size_t i = range_begin(); i < range_end(); ++i)
      residual_[i] = -gradient_[i] - product_[i];
    double size = precondition();
    // The size of the gradient before limits are run into is the scale of the tolerance.
    if (is_first) initial_size_ = size;
    const double min_size = initial_size_ * tolerance * tolerance;
    search_direction_ = preconditioned_residual_;
    for (int iteration = 0; iteration < MAX_CG_STEPS && size > min_size && size > 0; ++iteration) {
      band_.multiply(search_direction_, dof_count_, product_);
      const double curvature = dot_product(search_direction_, product_);
      if (!(curvature > 0)) return;
      const double step_length = size / curvature;
      for (std::size_t i = range_begin(); i < range_end(); ++i) {
        step_[i] += step_length * search_direction_[i];
        residual_[i] -= step_length * product_[i];
      }
      const double next_size = precondition();
      for (std::size_t i = range_begin(); i < range_end(); ++i)
        search_direction_[i] =
            preconditioned_residual_[i] + next_size / size * search_direction_[i];
      size = next_size;
    }
  }

  // Projects residual_, and computes preconditioned_residual_, the preconditioned residual; returns
  // their dot product. Frames are traversed back and forth, so that the last ones are still in the
  // cache.
  double precondition() {
    double* x = preconditioned_residual_.data();
    for (int t = first_; t < end_; ++t) {
      project(residual_, t);
      std::copy(frame(residual_, t), frame(residual_, t) + dof_count_,
                frame(preconditioned_residual_, t));
      band_.forward(x, t - first_, dof_count_);
      pin_band_.forward(residual_.data(), x, t - first_, dof_count_);
      ball_band_.forward(residual_.data(), x, t - first_, dof_count_);
    }
    double sum = 0;
    // A frame is projected once the two frames before it are solved.
    for (int t = end_ + 1; t >= first_; --t) {
      if (t - 2 >= first_) {
        const int i = t - 2 - first_;
        pin_band_.store_row(x, i, dof_count_), ball_band_.store_row(x, i, dof_count_);
        band_.backward(x, i, dof_count_);
        pin_band_.backward(x, i, dof_count_), ball_band_.backward(x, i, dof_count_);
      }
      if (t >= end_) continue;
      project(preconditioned_residual_, t);
      sum += inner(frame(preconditioned_residual_, t), frame(residual_, t), 0, dof_count_);
    }
    return sum;
  }

  double dot_product(std::vector<double>& a, std::vector<double>& b) {
    double sum = 0;
    for (int t = first_; t < end_; ++t) sum += inner(frame(a, t), frame(b, t), 0, dof_count_);
    return sum;
  }

  // Range of the current frames in arrays (F, D).
  std::size_t range_begin() const { return static_cast<std::size_t>(first_) * dof_count_; }
  std::size_t range_end() const { return static_cast<std::size_t>(end_) * dof_count_; }

  // Fixes limits that the step violates; returns whether there are any.
  bool fix_violations() {
    bool has_fixed = false;
    for (int t = first_; t < end_; ++t) {
      GoalSpace& space = goal_spaces_[t];
      std::copy(pose(current_path_, t), pose(current_path_, t) + coordinate_count_,
                state_.q.begin());
      if (!stepper_.fix_violations(state_, frame(step_, t), space.fixed_directions,
                                   space.limit_flags))
        continue;
      load_frame(t);
      update_null_space(t);
      has_fixed = true;
    }
    return has_fixed;
  }

  // Computes next_path_, the path after the step, restored to its goals. Returns false if a frame
  // cannot be restored; unless `can_retry`, such a frame is frozen from now on.
  bool apply_step(bool can_retry) {
    next_path_ = current_path_;
    stepped_pose_.resize(coordinate_count_);
    bool is_restored = true;
    for (int t = first_; t < end_; ++t) {
      if (is_frozen_[t]) continue;
      stepper_.move(pose(current_path_, t), frame(step_, t), stepped_pose_.data());
      if (restore_goals(t, stepped_pose_.data())) continue;
      is_restored = false;
      is_frozen_[t] = !can_retry;
    }
    return is_restored;
  }

  Task task_;
  const Chain unstretched_;
  const Settings settings_, tight_settings_;
  const PathSettings path_;
  const int frame_count_, dof_count_, coordinate_count_;
  int first_, end_;  // range of frames that currently change
  std::vector<double> targets_;
  const double* stretch_factors_;
  PathCost cost_;
  TimeBand band_;
  LimitBand<1> pin_band_;  // for joints at a limit
  LimitBand<3> ball_band_;
  Search search_;
  Stepper stepper_;
  State state_;
  Linearized linear_;
  std::vector<GoalSpace> goal_spaces_;
  GoalSpace::Buffers buffers_;
  std::vector<char> is_frozen_;
  std::vector<double> current_path_, next_path_, anchors_, tangent_, gradient_, step_, product_;
  std::vector<double> residual_, search_direction_, preconditioned_residual_, stepped_pose_;
  double damping_ = 0, initial_size_ = 0;
};

}  // namespace

}  // namespace ik

using namespace ik;

IkSmoothResult smooth_ik(const IkSmoothArguments& arrays) {
  const auto& [nodes, numbers, goals, goal_numbers, path, targets, reachable, stretches, drifts,
               anchor, speed, acceleration, first, end, length_tolerance, angle_tolerance, damping,
               rounds] = arrays;
  Task task = read_task(nodes, numbers, goals, goal_numbers, 0);
  const Chain unstretched = task.chain;
  const std::size_t frames = path.shape(0), width = path.shape(1), goal_count = goals.shape(0);
  check_poses("path", task, frames, path);
  check::at_most("path", frames, check::MAX_ROWS);
  check_targets("targets", task, frames, targets);
  check_targets("reachable", task, frames, reachable);
  check::shape("stretches", stretches, {frames, goal_count});
  check_steps("drifts", drifts, frames, task.chain.dof_count);
  check::non_negative("anchor", anchor);
  check::non_negative("speed", speed);
  check::non_negative("acceleration", acceleration);
  check::between("end", end, 0, frames);
  check::between("first", first, 0, end);
  check_tolerances(length_tolerance, angle_tolerance, damping);
  check::between("rounds", rounds, 0, std::numeric_limits<int>::max());
  const Settings settings{length_tolerance, angle_tolerance, damping, 1, 0, 0, 0, false};
  const PathSettings path_settings{
      {anchor, speed, acceleration}, static_cast<int>(first), static_cast<int>(end), rounds};
  Out<double, 2> smoothed_path(frames, width);
  Out<double, 3> errors(frames, goal_count, COMPONENT_COUNT);
  std::copy(path.data(), path.data() + frames * width, smoothed_path.get());
  PathSmoother smoother(task, settings, path_settings, static_cast<int>(frames), reachable.data(),
                        stretches.data(), drifts.data());
  const PathOutcome outcome = smoother.run(smoothed_path.get());
  State state(task);
  for (std::size_t t = 0; t < frames; ++t) {
    std::copy(smoothed_path.get() + t * width, smoothed_path.get() + (t + 1) * width,
              state.q.begin());
    stretch_limbs(unstretched, stretches.data() + t * goal_count, task);
    compute_frames(task.chain, state.q.data(), state.frames);
    measure(task, targets.data() + t * goal_count * TARGET_WIDTH, state);
    std::copy(state.errors.begin(), state.errors.end(),
              errors.get() + t * goal_count * COMPONENT_COUNT);
  }
  return {std::move(smoothed_path), std::move(errors), outcome.iterations, outcome.start_cost,
          outcome.end_cost};
}

}  // namespace animtool
