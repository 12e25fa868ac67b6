// Smooths a path of poses within limits while the points of its goals stay in place.
//
// Over all frames at once: min sum |q - anchor|^2 + speed |v|^2 + acceleration |a|^2 by
// Gauss-Newton, its steps in the null space of the goals' Jacobians. Of balls, differences
// are rotation vectors. With the goals' projections Pi and the same scalar matrix P of
// five diagonals for every degree of freedom, Pi P Pi x = Pi b is solved by conjugate
// gradients with Pi P^-1 Pi for a preconditioner, exact where Pi does not change in time
// or changes by limits alone: P^-1 is over the steps that they allow (N. Gould, M. Hribar, J.
// Nocedal, On the solution of equality constrained quadratic programming problems arising in
// optimization, 2001, algorithm 2.1).
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
  int first, end;  // frames that may move
  int rounds;      // largest number of Gauss-Newton iterations
};

struct PathOutcome {
  int rounds = 0;
  double before = 0, after = 0;
};

class PathSmoother {
 public:
  // `stretches` (F, E) are factors of the limbs' bone lengths; `drifts` (F - 1, D) is the motion
  // from frame to frame without cost.
  PathSmoother(const Task& task, const Settings& settings, const PathSettings& path, int frames,
               const double* targets, const double* stretches, const double* drifts)
      : task_(of_goals_alone(task)),
        plain_(task_.chain),
        settings_(settings),
        tight_(tightened(settings)),
        path_(path),
        frames_(frames),
        width_(task.chain.dofs),
        coordinates_(task.chain.coordinates),
        first_(path.first),
        end_(path.end),
        targets_(targets, targets + frames * task.goals.size() * TARGET_WIDTH),
        stretches_(stretches),
        cost_(task_.chain, frames, path.weights, drifts),
        band_(frames, path.first, path.end, path.weights),
        search_(task_, tight_),
        stepper_(task_),
        state_(task_),
        linear_(task_),
        spaces_(frames),
        frozen_(frames, 0),
        difference_(width_) {}

  // Improves a path (F, Q) in place.
  PathOutcome run(double* path) {
    now_.assign(path, path + static_cast<std::size_t>(frames_) * coordinates_);
    anchors_ = now_;
    for (int t = 0; t < frames_; ++t) hold_missed_goals(t);
    PathOutcome outcome;
    outcome.before = evaluate_all();
    std::vector<char> visited(frames_, 0);
    minimize(outcome, outcome.before);
    if (path_.weights.acceleration > 0 && path_.rounds > 0)
      for (int i = 0; i < CORNERS && select_corner(visited); ++i) {
        minimize(outcome, local_cost());
        shift_crossings(outcome);
      }
    outcome.after = evaluate_all();
    std::copy(now_.begin(), now_.end(), path);
    return outcome;
  }

 private:
  // Goals are restored to this fraction of their tolerance, in at most this many steps.
  static constexpr double TOLERANCE_FRACTION = 1e-2;
  static constexpr int STEPS = 30;
  // An iteration that gains less than this fraction is the last one.
  static constexpr double MIN_GAIN = 1e-2;
  // Largest number of corners that are treated separately.
  static constexpr int CORNERS = 8;
  // A frame is a corner if it costs this many times the median of the frames around it. Passing it
  // earlier or later is tried in steps of this many frames, this many times.
  static constexpr double CORNER_RATIO = 10, SHIFT = 0.5;
  static constexpr int SHIFTS = 8;
  // Attempts of a step, and the factor of the damping from one to the next.
  static constexpr int MAX_ATTEMPTS = 8;
  static constexpr double DAMPING_FACTOR = 4;
  // Passes over the limits, steps of conjugate gradients, and their tolerance.
  static constexpr int PASSES = 5, MAX_CG_STEPS = 60;
  static constexpr double CG_TOLERANCE = 1e-2, FIRST_CG_TOLERANCE = 3e-1;

  // The values of goals are kept, even if they yielded to other goals or to a preference.
  static Task of_goals_alone(Task task) {
    task.rest_weight = 0;
    task.levels = 1;
    return task;
  }

  static Settings tightened(Settings settings) {
    settings.length_tolerance *= TOLERANCE_FRACTION;
    settings.angle_tolerance *= TOLERANCE_FRACTION;
    settings.iterations = STEPS;
    settings.restarts = 0;
    return settings;
  }

  double* target(int t) {
    return targets_.data() + static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }

  double* frame(std::vector<double>& of, int t) {
    return of.data() + static_cast<std::size_t>(t) * width_;
  }

  double* pose(std::vector<double>& of, int t) {
    return of.data() + static_cast<std::size_t>(t) * coordinates_;
  }

  void stretch_limbs(int t) { stretch(plain_, stretches_ + t * task_.goals.size(), task_); }

  // Corrects a pose so that it meets the goals of a frame.
  bool restore_goals(int t, const double* start) {
    stretch_limbs(t);
    if (search_.run(start, target(t), start, false) == Status::BROKEN) return false;
    const State& best = search_.best();
    std::copy(best.q.begin(), best.q.end(), pose(next_, t));
    return reached(best);
  }

  void load_frame(int t) {
    stretch_limbs(t);
    const double* q = pose(now_, t);
    std::copy(q, q + coordinates_, state_.q.begin());
    forward(task_.chain, state_.q.data(), state_.frames);
    measure(task_, target(t), state_);
    // A goal is kept however small its weight is.
    for (double& weight : state_.weights) weight = weight > 0 ? 1 : 0;
  }

  bool reached(const State& state) const {
    for (std::size_t i = 0; i < state.errors.size(); ++i)
      if (!(state.errors[i] <= settings_.tolerance(static_cast<int>(i % PARTS)))) return false;
    return true;
  }

  // If a frame misses a goal, the current value becomes the target.
  void hold_missed_goals(int t) {
    load_frame(t);
    if (reached(state_)) return;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      const Goal& goal = task_.goals[e];
      double* reached_target = target(t) + TARGET_WIDTH * e;
      const View view = view_of(goal, state_, &state_.points[3 * e]);
      each_kind([&]<class Kind>(int part) {
        if (!Kind::LIMB || goal.middle >= 0)
          Kind::target_from_pose(view, reached_target + COLUMNS[part]);
      });
    }
  }

  // Iterates over the frames first_ to end_ until the gain is small relative to `scale`.
  void minimize(PathOutcome& outcome, double scale) {
    damping_ = 0;
    double cost = evaluate(now_);
    for (int round = 0; round < path_.rounds; ++round) {
      const double next = improve(cost);
      if (!(next < cost)) return;
      ++outcome.rounds;
      const bool enough = cost - next < MIN_GAIN * scale;
      cost = next;
      if (enough) return;
    }
  }

  // Moves only the frames around the sharpest remaining corner: the others have converged, and must
  // not limit the step length.
  bool select_corner(std::vector<char>& visited) {
    evaluate_all();
    int sharpest = -1;
    for (int t = path_.first; t < path_.end; ++t)
      if (!visited[t] && (sharpest < 0 || cost_.frame_costs[t] > cost_.frame_costs[sharpest]))
        sharpest = t;
    if (sharpest < 0) return false;
    const double time = std::sqrt(std::sqrt(path_.weights.acceleration));
    const int reach = static_cast<int>(std::clamp(2 * time, 8.0, 60.0));
    first_ = std::max(sharpest - reach, path_.first);
    end_ = std::min(sharpest + reach + 1, path_.end);
    std::fill(visited.begin() + std::max(sharpest - reach / 2, 0),
              visited.begin() + std::min(sharpest + reach / 2 + 1, frames_), 1);
    std::fill(frozen_.begin(), frozen_.end(), 0);
    band_ = TimeBand(frames_, first_, end_, path_.weights);
    return true;
  }

  // A path that passes near a singular pose has a corner that no small change removes; it can be
  // smooth only if it passes at another moment. So other moments are tried.
  void shift_crossings(PathOutcome& outcome) {
    for (const double wide : {1.0, 0.5})
      for (int tried = 0; tried < 2 * SHIFTS; ++tried) {
        if (!has_corner()) return;
        const double by = (tried / 2 + 1) * SHIFT * (tried % 2 ? -1 : 1);
        const double cost = evaluate(now_);
        const std::vector<double> before = now_;
        if (shift(by, wide)) minimize(outcome, local_cost());
        if (!(evaluate(now_) < cost)) now_ = before;
      }
    evaluate(now_);
  }

  // Whether a frame is a corner.
  bool has_corner() {
    evaluate(now_);
    const auto worst =
        std::max_element(cost_.frame_costs.begin() + first_, cost_.frame_costs.begin() + end_);
    std::vector<double> others(cost_.frame_costs.begin() + first_,
                               cost_.frame_costs.begin() + end_);
    std::nth_element(others.begin(), others.begin() + others.size() / 2, others.end());
    return *worst > CORNER_RATIO * others[others.size() / 2];
  }

  // Shifts the moving frames in time, most in their middle; now_ <- the path restored to its goals.
  // Returns false if a frame cannot be restored.
  bool shift(double by, double wide) {
    const double middle = (first_ + end_ - 1) / 2.0, reach = wide * (end_ - first_ + 1) / 2.0;
    next_ = now_;
    step_.resize(slope_.size());
    for (int t = first_; t < end_; ++t) {
      const double away = std::fabs(t - middle) / reach;
      if (away >= 1) continue;
      const double softened = std::cos(away * REVOLUTION / 4);
      const double at = std::clamp(t + by * softened * softened, 0.0, frames_ - 1.0);
      const int from = std::min(static_cast<int>(at), frames_ - 2);
      difference(task_.chain, pose(now_, from), pose(now_, from + 1), difference_.data());
      for (double& x : difference_) x *= at - from;
      moved_.resize(coordinates_);
      stepper_.move(pose(now_, from), difference_.data(), moved_.data());
      if (!restore_goals(t, moved_.data())) return false;
    }
    now_.swap(next_);
    return true;
  }

  double local_cost() const {
    double cost = 0;
    for (int t = first_; t < end_; ++t) cost += cost_.frame_costs[t];
    return cost;
  }

  double evaluate_all() { return cost_.evaluate(anchors_.data(), now_.data()); }

  // Of what changes with the frames that currently move.
  double evaluate(const std::vector<double>& q, std::vector<double>* slope = nullptr) {
    return cost_.evaluate(anchors_.data(), q.data(), slope, first_, end_);
  }

  // Makes one iteration; returns the cost after it. A step that is too long is repeated with more
  // damping.
  double improve(double cost) {
    evaluate(now_, &slope_);
    for (int i = 0; i < MAX_ATTEMPTS; ++i) {
      const double stiffness = solve_step();
      if (longest() < MAX_ROTATION && take(i + 1 < MAX_ATTEMPTS)) {
        const double next = evaluate(next_);
        if (next < cost) {
          now_.swap(next_);
          damping_ /= DAMPING_FACTOR;
          return next;
        }
      }
      damping_ = DAMPING_FACTOR * std::max(damping_, stiffness);
    }
    return cost;
  }

  // step_ <- the best step within the limits; returns the stiffness of the path along it.
  double solve_step() {
    band_.damp(damping_);
    step_.assign(slope_.size(), 0.0);
    for (int t = first_; t < end_; ++t) linearize_frame(t);
    // Limits that are run into show up in rough steps.
    bool tight = false;
    for (int pass = 0; pass < PASSES; ++pass) {
      tight = tight || pass + 1 == PASSES;
      solve(tight ? CG_TOLERANCE : FIRST_CG_TOLERANCE, pass == 0);
      if (fix_violations()) continue;
      if (tight) break;
      tight = true;
    }
    band_.multiply(step_, width_, image_);
    double bend = 0, size = 1e-300;
    for (std::size_t i = begin(); i < end(); ++i)
      bend += step_[i] * image_[i], size += step_[i] * step_[i];
    return bend / size;
  }

  double longest() const {
    double most = 0;
    for (const double x : step_) most = std::max(most, std::fabs(x));
    return most;
  }

  // Locked limits, and the null space of the goals, at the current pose.
  void linearize_frame(int t) {
    load_frame(t);
    stepper_.fix_locked(state_, spaces_[t].fixed, spaces_[t].at_limit);
    update_null_space(t);
  }

  void update_null_space(int t) {
    differentiate(task_, target(t), state_, linear_.columns);
    spaces_[t].update_null_space(task_.rows, width_, linear_.columns, work_);
  }

  // Takes out of a frame of x what goals and limits feel.
  void project(std::vector<double>& x, int t) {
    double* values = frame(x, t);
    if (frozen_[t])
      std::fill(values, values + width_, 0.0);
    else
      spaces_[t].project(values, work_);
  }

  // step_ <- the best step that goals and fixed limits allow, starting from the previous one.
  void solve(double near, bool first) {
    const std::size_t size = slope_.size();
    const auto fixed = [&](int t) -> const std::vector<Fixed>& { return spaces_[t].fixed; };
    pins_.factor(band_, first_, end_, fixed), balls_.factor(band_, first_, end_, fixed);
    for (int t = first_; t < end_; ++t) project(step_, t);
    for (int t = first_; t < end_; ++t) {
      if (frozen_[t]) continue;
      double* values = frame(step_, t);
      for (int d = 0; d < width_; ++d) values[d] += spaces_[t].step[d];
    }
    image_.assign(size, 0.0);
    band_.multiply(step_, width_, image_);
    residual_.assign(size, 0.0);
    conditioned_.assign(size, 0.0);
    for (std::size_t i = begin(); i < end(); ++i) residual_[i] = -slope_[i] - image_[i];
    double size_now = precondition();
    // What the slope comes to before limits are run into says what is small.
    if (first) full_ = size_now;
    const double small = full_ * near * near;
    search_direction_ = conditioned_;
    for (int round = 0; round < MAX_CG_STEPS && size_now > small && size_now > 0; ++round) {
      band_.multiply(search_direction_, width_, image_);
      const double bend = product(search_direction_, image_);
      if (!(bend > 0)) return;
      const double amount = size_now / bend;
      for (std::size_t i = begin(); i < end(); ++i) {
        step_[i] += amount * search_direction_[i];
        residual_[i] -= amount * image_[i];
      }
      const double next = precondition();
      for (std::size_t i = begin(); i < end(); ++i)
        search_direction_[i] = conditioned_[i] + next / size_now * search_direction_[i];
      size_now = next;
    }
  }

  // Projects rest_, and conditioned_ <- what it comes to; the product of both. Frames are
  // gone through forth and back, so that those last read are still near.
  double precondition() {
    double* x = conditioned_.data();
    for (int t = first_; t < end_; ++t) {
      project(residual_, t);
      std::copy(frame(residual_, t), frame(residual_, t) + width_, frame(conditioned_, t));
      band_.forward(x, t - first_, width_);
      pins_.forward(residual_.data(), x, t - first_, width_);
      balls_.forward(residual_.data(), x, t - first_, width_);
    }
    double sum = 0;
    // A frame is projected once the two before it are solved.
    for (int t = end_ + 1; t >= first_; --t) {
      if (t - 2 >= first_) {
        const int i = t - 2 - first_;
        pins_.keep(x, i, width_), balls_.keep(x, i, width_);
        band_.backward(x, i, width_);
        pins_.backward(x, i, width_), balls_.backward(x, i, width_);
      }
      if (t >= end_) continue;
      project(conditioned_, t);
      sum += inner(frame(conditioned_, t), frame(residual_, t), 0, width_);
    }
    return sum;
  }

  double product(std::vector<double>& a, std::vector<double>& b) {
    double sum = 0;
    for (int t = first_; t < end_; ++t) sum += inner(frame(a, t), frame(b, t), 0, width_);
    return sum;
  }

  std::size_t begin() const { return static_cast<std::size_t>(first_) * width_; }
  std::size_t end() const { return static_cast<std::size_t>(end_) * width_; }

  bool fix_violations() {
    bool improved = false;
    for (int t = first_; t < end_; ++t) {
      GoalSpace& space = spaces_[t];
      std::copy(pose(now_, t), pose(now_, t) + coordinates_, state_.q.begin());
      if (!stepper_.fix_violations(state_, frame(step_, t), space.fixed, space.at_limit)) continue;
      load_frame(t);
      update_null_space(t);
      improved = true;
    }
    return improved;
  }

  // next_ <- the path after the step, restored to its goals. Returns false if a frame cannot be
  // restored; without `again`, such a frame is fixed from now on.
  bool take(bool again) {
    next_ = now_;
    moved_.resize(coordinates_);
    bool good = true;
    for (int t = first_; t < end_; ++t) {
      if (frozen_[t]) continue;
      stepper_.move(pose(now_, t), frame(step_, t), moved_.data());
      if (restore_goals(t, moved_.data())) continue;
      good = false;
      frozen_[t] = !again;
    }
    return good;
  }

  Task task_;
  const Chain plain_;
  const Settings settings_, tight_;
  const PathSettings path_;
  const int frames_, width_, coordinates_;
  int first_, end_;  // frames that currently move
  std::vector<double> targets_;
  const double* stretches_;
  PathCost cost_;
  TimeBand band_;
  LimitBand<1> pins_;  // of joints that a limit fixes
  LimitBand<3> balls_;
  Search search_;
  Stepper stepper_;
  State state_;
  Linearized linear_;
  std::vector<GoalSpace> spaces_;
  GoalSpace::Work work_;
  std::vector<char> frozen_;
  std::vector<double> now_, next_, anchors_, difference_, slope_, step_, image_;
  std::vector<double> residual_, search_direction_, conditioned_, moved_;
  double damping_ = 0, full_ = 0;
};

}  // namespace

}  // namespace ik

using namespace ik;

IkSmoothed smooth_ik(const IkSmoothing& arrays) {
  const auto& [nodes, numbers, goals, goal_numbers, path, targets, reachable, stretches, drifts,
               anchor, speed, acceleration, first, end, length_tolerance, angle_tolerance, damping,
               rounds] = arrays;
  Task task = read_task(nodes, numbers, goals, goal_numbers, 0);
  const Chain plain = task.chain;
  const std::size_t frames = path.shape(0), width = path.shape(1), e = goals.shape(0);
  check_poses("path", task, frames, path);
  check::at_most("path", frames, check::MAX_ROWS);
  check_targets("targets", task, frames, targets);
  check_targets("reachable", task, frames, reachable);
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
  const PathSettings over{
      {anchor, speed, acceleration}, static_cast<int>(first), static_cast<int>(end), rounds};
  Out<double, 2> smoothed(frames, width);
  Out<double, 3> errors(frames, e, PARTS);
  std::copy(path.data(), path.data() + frames * width, smoothed.get());
  PathSmoother smoother(task, settings, over, static_cast<int>(frames), reachable.data(),
                        stretches.data(), drifts.data());
  const PathOutcome outcome = smoother.run(smoothed.get());
  State state(task);
  for (std::size_t t = 0; t < frames; ++t) {
    std::copy(smoothed.get() + t * width, smoothed.get() + (t + 1) * width, state.q.begin());
    stretch(plain, stretches.data() + t * e, task);
    forward(task.chain, state.q.data(), state.frames);
    measure(task, targets.data() + t * e * TARGET_WIDTH, state);
    std::copy(state.errors.begin(), state.errors.end(), errors.get() + t * e * PARTS);
  }
  return {std::move(smoothed), std::move(errors), outcome.rounds, outcome.before, outcome.after};
}

}  // namespace animtool
