// Fits the poses of a clip to weighted goals: robust to outliers, smooth in time, and within the
// limits.
//
// Minimises over all frames at once: sum rho(|r|) + speed |v|^2 / 2 + acceleration |a|^2 / 2, with
// rho(r) = r^2 / 2 / (1 + r^2 / c^2) (S. Geman, D. McClure, Statistical methods for tomographic
// image reconstruction, 1987) for each goal, by reweighted Gauss-Newton. Before that, frames are
// solved one after the other, each from a pose extrapolated from earlier frames, with c decreasing
// from the residuals of that pose (A. Blake, A. Zisserman, Visual reconstruction, 1987).
#include "ik/solve.h"

#include "ik/attempt.h"
#include "ik/blocks.h"
#include "ik/path_cost.h"
#include "ik/read.h"

namespace animtool {

namespace ik {

namespace {

struct FitSettings {
  PathWeights weights;
  double robust_scale;          // c, in units of weighted residuals; infinite for least squares
  double rest_return_fraction;  // fraction by which an unconstrained joint returns to its rest pose
                                // per frame
  int first, end;               // range of frames that may change
  int iterations;               // largest number of Gauss-Newton iterations over all frames
  bool solves_frames_first;     // whether frames are solved one after the other first
};

// Number of iterations over all frames, and the cost before and after them.
struct FitOutcome {
  int iterations = 0;
  double start_cost = 0, end_cost = 0;
};

class PathFit : public Descent {
 public:
  // `starts` (F, Q) are start poses for frames where extrapolation from earlier frames fails. The
  // task's rest weight is the weight of the extrapolated pose.
  PathFit(Task& task, const Settings& settings, const FitSettings& fit, int frame_count,
          const double* targets, const double* starts)
      : Descent(task, settings),
        mutable_task_(task),
        prediction_weight_(task.rest_weight),
        fit_(fit),
        frame_count_(frame_count),
        dof_count_(task.chain.dof_count),
        coordinate_count_(task.chain.coordinate_count),
        source_targets_(targets, targets + frame_count * task.goals.size() * TARGET_WIDTH),
        weighted_targets_(source_targets_),
        starts_(starts),
        cost_(task.chain, frame_count, fit.weights, nullptr),
        band_(frame_count, fit.first, fit.end, fit.weights),
        blocks_(dof_count_),
        rest_pose_(task.chain.coordinate_count),
        tangent_(dof_count_),
        state_(task) {
    min_gain_ = FRAME_MIN_GAIN;
    for (const Node& node : task.chain.nodes)
      if (node.kind == Kind::BALL && !node.is_driven) rest_pose_[node.coordinate + 3] = 1;
  }

  // Targets (F, E, W), after they were reassigned between goals.
  const double* targets(int t) const { return source_targets(t); }

  // Improves a path (F, Q) in place. `used_start_pose` (F,) is set for frames that used their start
  // pose, and `target_sources` (F, E) to the goal whose target a goal uses, -1 if it lost its
  // target.
  FitOutcome run(double* path, std::int64_t* used_start_pose, std::int64_t* target_sources) {
    target_sources_ = target_sources;
    path_.assign(path, path + static_cast<std::size_t>(frame_count_) * coordinate_count_);
    if (fit_.solves_frames_first)
      for (int t = fit_.first; t < fit_.end; ++t) used_start_pose[t] = solve_from_previous(t);
    anchors_ = path_;
    FitOutcome outcome;
    minimize(outcome);
    std::copy(path_.begin(), path_.end(), path);
    return outcome;
  }

 private:
  // Smallest relative gain of a step in one frame, and of an iteration over all frames.
  static constexpr double FRAME_MIN_GAIN = 1e-5, PATH_MIN_GAIN = 1e-4;
  // Smallest relative gain of an iteration with fixed weights, which only finds a start.
  static constexpr double FIXED_WEIGHTS_MIN_GAIN = 0.01;
  // Largest residual; the squares of larger ones overflow.
  static constexpr double MAX_RESIDUAL = 1e100;
  // Residuals above this multiple of their median at a start are probably outliers. The scale is
  // halved in each descent, at most this often.
  static constexpr double OUTLIER_RATIO = 3;
  static constexpr int MAX_HALVINGS = 8;
  // If the goals of a frame cost more than this fraction of their largest cost on average, the
  // frame is searched from this many other starts; a result has to cost less than this fraction of
  // the previous cost.
  static constexpr double LOST_COST_FRACTION = 0.45, IMPROVEMENT_RATIO = 0.8;
  static constexpr int MAX_RESTARTS = 4;
  // Weight of the start pose in a search from another start: unconstrained joints keep it.
  static constexpr double START_WEIGHT = 1;
  // A target is unmatched if its squared error exceeds this multiple of c^2. It is assigned to
  // another goal that is within this multiple of c, and nearer by this factor. If more targets than
  // this are unmatched, the pose is wrong, not the targets.
  static constexpr double UNMATCHED_ERROR_RATIO = 2, MAX_REASSIGN_DISTANCE_RATIO = 2,
                          NEARER_DISTANCE_RATIO = 0.25;
  static constexpr std::size_t MAX_UNMATCHED_GOALS = 16;
  // This many goals outweigh the pose extrapolated from earlier frames.
  static constexpr double PREDICTION_GOALS = 3;
  // Fraction of the velocity that remains per frame without observations.
  static constexpr double VELOCITY_DECAY = 0.9;
  // Attempts per iteration, and the factor by which the damping grows between them.
  static constexpr int MAX_ATTEMPTS = 6;
  static constexpr double DAMPING_GROWTH = 10;
  // Step along the gradient that tests whether a limit blocks a joint [rad].
  static constexpr double PROBE_STEP = 1e-6;
  // Stiffness of a limit, over that of the stiffest degree of freedom.
  static constexpr double LIMIT_STIFFNESS = 1e6;

  // Row of a frame in a path (F, Q), and in tangent vectors (F, D).
  double* pose(std::vector<double>& path, int t) {
    return path.data() + static_cast<std::size_t>(t) * coordinate_count_;
  }
  double* row(std::vector<double>& rows, int t) {
    return rows.data() + static_cast<std::size_t>(t) * dof_count_;
  }
  // Targets of a frame, with robust weights and with their original ones.
  double* weighted_targets(int t) {
    return weighted_targets_.data() +
           static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }
  double* source_targets(int t) {
    return source_targets_.data() + static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }
  const double* source_targets(int t) const {
    return source_targets_.data() + static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }

  // Calls f(goal, component, squared weighted error) for all components of goals with a weight in a
  // frame.
  template <class F>
  void for_each_error(int t, const State& state, F&& f) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      for (int component = 0; component < COMPONENT_COUNT; ++component) {
        const double weight =
            weight_of(task_.goals[e], source_targets(t) + TARGET_WIDTH * e, component);
        if (!(weight > 0)) continue;
        const double error = weight * state.errors[COMPONENT_COUNT * e + component];
        // Poses and targets may contain any numbers: NaN counts as far away.
        f(e, component,
          std::fabs(error) < MAX_RESIDUAL ? error * error : MAX_RESIDUAL * MAX_RESIDUAL);
      }
  }

  // Cost of the goals of a frame at a pose: at most c^2 / 2 each.
  double robust_cost(int t, const State& state, double scale) const {
    double cost = 0;
    for_each_error(t, state, [&](std::size_t, int, double square) {
      cost += square / 2 / (1 + square / (scale * scale));
    });
    return cost;
  }

  // Mean cost of the goals of a frame, as a fraction of the largest possible cost.
  double cost_fraction(int t, const State& state) const {
    double sum = 0;
    int count = 0;
    const double limit = fit_.robust_scale * fit_.robust_scale;
    for_each_error(t, state, [&](std::size_t, int, double square) {
      sum += square / (limit + square), ++count;
    });
    return count ? sum / count : 0;
  }

  // Computes the robust weights of the goals from their errors.
  void reweight(int t, const State& state, double scale) {
    double* out = weighted_targets(t);
    for_each_error(t, state, [&](std::size_t e, int component, double square) {
      out[TARGET_WIDTH * e + WEIGHTS_OFFSET + component] =
          source_targets(t)[TARGET_WIDTH * e + WEIGHTS_OFFSET + component] /
          (1 + square / (scale * scale));
    });
  }

  // Median weighted error of the goals of a frame.
  double median_error(int t, const State& state) {
    squared_errors_.clear();
    for_each_error(t, state,
                   [&](std::size_t, int, double square) { squared_errors_.push_back(square); });
    if (squared_errors_.empty()) return 0;
    std::nth_element(squared_errors_.begin(), squared_errors_.begin() + squared_errors_.size() / 2,
                     squared_errors_.end());
    return std::sqrt(squared_errors_[squared_errors_.size() / 2]);
  }

  // Evaluates a pose, with the errors of all goals that have targets, even if their weight is 0.
  void evaluate_pose(int t, const double* q, State& state) {
    std::copy(q, q + coordinate_count_, state.q.begin());
    compute_frames(task_.chain, state.q.data(), state.frames);
    measure(task_, source_targets(t), state);
  }

  double max_error(int t, const State& state) const {
    double largest = 0;
    for_each_error(t, state,
                   [&](std::size_t, int, double square) { largest = std::max(largest, square); });
    return std::sqrt(largest);
  }

  // Cost of a pose's distance from the extrapolated pose; at most that of PREDICTION_GOALS goals.
  double prediction_cost(const double* q, const double* predicted) {
    difference(task_.chain, predicted, q, tangent_.data());
    double square = 0;
    for (const double x : tangent_) square += x * x;
    const double cost = prediction_weight_ * square / 2,
                 max_cost = PREDICTION_GOALS * fit_.robust_scale * fit_.robust_scale / 2;
    return std::isfinite(max_cost) ? cost / (1 + cost / max_cost) : cost;
  }

  // Solves a frame from a start; state_ is the pose at the end. Returns the cost of its goals.
  // Errors at the start above a scale count little at first.
  double solve_frame(int t, const double* start, const double* preferred_pose,
                     bool trusts_targets) {
    evaluate_pose(t, start, state_);
    double scale = trusts_targets ? max_error(t, state_) : OUTLIER_RATIO * median_error(t, state_);
    scale = std::max(fit_.robust_scale, scale);
    mutable_task_.rest_weight =
        trusts_targets ? std::min(START_WEIGHT, prediction_weight_) : prediction_weight_;
    start_.assign(start, start + coordinate_count_);
    for (int i = 0; i < MAX_HALVINGS; ++i) {
      reweight(t, state_, scale);
      if (!begin_problem(start_.data(), weighted_targets(t), preferred_pose)) break;
      set_current(best_);
      descend(settings_.damping, false);
      if (current_.cost < best_.cost) std::swap(current_, best_);
      std::copy(best_.q.begin(), best_.q.end(), start_.data());
      evaluate_pose(t, start_.data(), state_);
      if (!(scale > fit_.robust_scale)) break;
      scale =
          std::max(fit_.robust_scale, std::min(scale / 2, OUTLIER_RATIO * median_error(t, state_)));
    }
    return robust_cost(t, state_, fit_.robust_scale);
  }

  // Extrapolates a pose from earlier frames.
  void predict(int t, double* out) {
    const double* last = pose(path_, t - 1);
    std::fill(tangent_.begin(), tangent_.end(), 0.0);
    if (t > 1) difference(task_.chain, pose(path_, t - 2), last, tangent_.data());
    for (double& x : tangent_) x *= VELOCITY_DECAY;
    stepper_.move(last, tangent_.data(), out);
  }

  // Moves unconstrained joints of a pose towards their rest pose.
  void relax_to_rest(double* out) {
    difference(task_.chain, out, rest_pose_.data(), tangent_.data());
    for (const Node& node : task_.chain.nodes)
      for (int k = 0; k < (node.program < 0 ? node.dof_count() : 0); ++k)
        tangent_[node.dof + k] *=
            node.kind == Kind::SLIDE || is_root(node) ? 0 : fit_.rest_return_fraction;
    stepper_.move(std::vector<double>(out, out + coordinate_count_).data(), tangent_.data(), out);
  }

  // Solves a frame, starting from earlier frames; returns 1 if it used its start pose.
  std::int64_t solve_from_previous(int t) {
    std::vector<double> start(coordinate_count_), preferred_pose(coordinate_count_);
    const double* frame_start = starts_ + static_cast<std::size_t>(t) * coordinate_count_;
    const bool has_previous = t > 0;
    if (has_previous)
      predict(t, start.data());
    else
      std::copy(frame_start, frame_start + coordinate_count_, start.begin());
    preferred_pose = start;
    if (has_previous) relax_to_rest(preferred_pose.data());
    if (has_previous && std::isfinite(fit_.robust_scale)) reassign_targets(t, start.data());
    double cost = solve_frame(t, start.data(), preferred_pose.data(), !has_previous);
    std::vector<double> best_pose = state_.q;
    std::int64_t used_start_pose = !has_previous;
    if (has_previous && max_error(t, state_) > fit_.robust_scale) {
      const double current_cost = cost + prediction_cost(best_pose.data(), preferred_pose.data());
      const double other_cost = solve_frame(t, start.data(), preferred_pose.data(), true);
      if (other_cost + prediction_cost(state_.q.data(), preferred_pose.data()) < current_cost)
        cost = other_cost, best_pose = state_.q;
      evaluate_pose(t, best_pose.data(), state_);
    }
    if (reset_lost_joints(t, best_pose, start)) {
      const double other_cost = solve_frame(t, start.data(), start.data(), true);
      if (other_cost < cost) cost = other_cost, best_pose = state_.q;
      evaluate_pose(t, best_pose.data(), state_);
    }
    if (cost_fraction(t, state_) > LOST_COST_FRACTION) {
      for (int i = 0; i < MAX_RESTARTS; ++i) {
        std::copy(frame_start, frame_start + coordinate_count_, start.begin());
        if (i > 0) randomize_joints(start);
        const double other_cost = solve_frame(t, start.data(), start.data(), true);
        if (!(other_cost < IMPROVEMENT_RATIO * cost)) continue;
        cost = other_cost, best_pose = state_.q, used_start_pose = 1;
      }
    }
    std::copy(best_pose.begin(), best_pose.end(), pose(path_, t));
    return used_start_pose;
  }

  // Sets `out` to a pose in which joints are at rest if all goals that they move are far off, such
  // as those of a neck whose head is lost; returns false if there are no such joints.
  bool reset_lost_joints(int t, const std::vector<double>& pose, std::vector<double>& out) {
    joint_flags_.assign(task_.chain.nodes.size(), 0);
    const double limit = fit_.robust_scale * fit_.robust_scale;
    for_each_error(t, state_, [&](std::size_t e, int, double square) {
      for (const int n : task_.goals[e].path) joint_flags_[n] |= square > limit ? 1 : 2;
    });
    out = pose;
    bool has_reset = false;
    for (std::size_t n = 0; n < joint_flags_.size(); ++n) {
      const Node& node = task_.chain.nodes[n];
      if (joint_flags_[n] != 1 || node.is_driven || node.kind == Kind::SLIDE || is_root(node))
        continue;
      const int size = node.kind == Kind::BALL ? 4 : 1;
      std::copy(rest_pose_.begin() + node.coordinate, rest_pose_.begin() + node.coordinate + size,
                out.begin() + node.coordinate);
      has_reset = true;
    }
    return has_reset;
  }

  // Reassigns targets with wrong labels: a target at the extrapolated position of another goal,
  // which has no target or is far from it, is assigned to that goal.
  void reassign_targets(int t, const double* start) {
    evaluate_pose(t, start, state_);
    unmatched_goals_.clear();
    const double limit = fit_.robust_scale * fit_.robust_scale;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      if (!(task_.goals[e].weights[0] > 0)) continue;
      const double weight = weight_of(task_.goals[e], source_targets(t) + TARGET_WIDTH * e, 0);
      const double error = weight * state_.errors[COMPONENT_COUNT * e];
      if (!(weight > 0) || error * error > UNMATCHED_ERROR_RATIO * limit)
        unmatched_goals_.push_back(e);
    }
    if (unmatched_goals_.size() < 2 || unmatched_goals_.size() > MAX_UNMATCHED_GOALS) return;
    std::int64_t* target_sources =
        target_sources_ + static_cast<std::size_t>(t) * task_.goals.size();
    const std::vector<double> targets_before(source_targets(t),
                                             source_targets(t) + task_.goals.size() * TARGET_WIDTH);
    for (const std::size_t from : unmatched_goals_) {
      const double* target = targets_before.data() + TARGET_WIDTH * from;
      if (!(target[WEIGHTS_OFFSET] > 0)) continue;
      const double max_distance =
          MAX_REASSIGN_DISTANCE_RATIO * fit_.robust_scale / weight_of(task_.goals[from], target, 0);
      double min_distance =
          std::min(max_distance, NEARER_DISTANCE_RATIO * distance_to(from, target));
      std::size_t nearest = from;
      for (const std::size_t to : unmatched_goals_) {
        const double* current_target = targets_before.data() + TARGET_WIDTH * to;
        const bool is_unassigned =
            target_sources[to] < 0 || target_sources[to] == static_cast<std::int64_t>(to);
        const double distance = distance_to(to, target);
        if (to == from || !is_unassigned || distance > min_distance) continue;
        if (current_target[WEIGHTS_OFFSET] > 0 &&
            distance > NEARER_DISTANCE_RATIO * distance_to(to, current_target))
          continue;
        min_distance = distance, nearest = to;
      }
      if (nearest == from) continue;
      double* out = source_targets(t) + TARGET_WIDTH * nearest;
      std::copy(target, target + 3, out);
      out[WEIGHTS_OFFSET] = target[WEIGHTS_OFFSET];
      target_sources[nearest] = static_cast<std::int64_t>(from);
      if (target_sources[from] != static_cast<std::int64_t>(from)) continue;
      // The goal has no target until another one is assigned.
      source_targets(t)[TARGET_WIDTH * from + WEIGHTS_OFFSET] = 0;
      target_sources[from] = -1;
    }
    std::copy(source_targets(t), source_targets(t) + task_.goals.size() * TARGET_WIDTH,
              weighted_targets(t));
  }

  // Distance of a target from a goal's point at state_.
  double distance_to(std::size_t e, const double* target) const {
    const double* point = &state_.points[3 * e];
    const double offset[3] = {target[0] - point[0], target[1] - point[1], target[2] - point[2]};
    return length(offset);
  }

  // Randomises all joints except the root.
  void randomize_joints(std::vector<double>& q) {
    std::vector<double> random_pose(q.size());
    sample_pose(task_.chain, q.data(), random_, random_pose.data());
    for (const Node& node : task_.chain.nodes) {
      if (node.is_driven || node.kind == Kind::SLIDE || is_root(node)) continue;
      const int size = node.kind == Kind::BALL ? 4 : 1;
      std::copy(random_pose.begin() + node.coordinate, random_pose.begin() + node.coordinate + size,
                q.begin() + node.coordinate);
    }
  }

  // Whether all joints above a node are slides.
  bool is_root(const Node& node) const {
    for (int n = node.parent; n >= 0; n = task_.chain.nodes[n].parent)
      if (task_.chain.nodes[n].kind != Kind::SLIDE) return false;
    return true;
  }

  // Minimises the cost over all frames.
  void minimize(FitOutcome& outcome) {
    if (fit_.first >= fit_.end) return;
    const int count = fit_.end - fit_.first;
    blocks_.resize(count);
    for (int i = 0; i < count; ++i)
      blocks_.set_couplings(i, band_.entry(fit_.first + i, -1), band_.entry(fit_.first + i, -2));
    outcome.start_cost = outcome.end_cost = evaluate(path_, false);
    // Frames that were solved one by one are not smooth. The first smoothing step is long, and
    // would lose goals, whose weight falls with their error. So weights are fixed at first.
    if (fit_.solves_frames_first && std::isfinite(fit_.robust_scale)) {
      for (int t = fit_.first; t < fit_.end; ++t) {
        evaluate_pose(t, pose(path_, t), state_);
        reweight(t, state_, fit_.robust_scale);
      }
      iterate_all_frames(outcome, true);
    }
    iterate_all_frames(outcome, false);
  }

  // Iterates over all frames at once. With `keeps_weights`, goals keep their current weights.
  void iterate_all_frames(FitOutcome& outcome, bool keeps_weights) {
    double cost = evaluate(path_, keeps_weights), damping = 0;
    for (int iteration = 0; iteration < fit_.iterations; ++iteration) {
      assemble(keeps_weights);
      const double previous_cost = cost;
      bool is_better = false;
      for (int i = 0; i < MAX_ATTEMPTS && !is_better; ++i) {
        if (try_path_step(damping)) {
          const double next_cost = evaluate(next_path_, keeps_weights);
          is_better = next_cost < cost;
          if (is_better) cost = next_cost, path_.swap(next_path_);
        }
        damping = is_better ? damping / DAMPING_GROWTH
                            : std::max(damping, 1e-6 * max_stiffness_) * DAMPING_GROWTH;
      }
      if (!is_better) break;
      ++outcome.iterations;
      if (previous_cost - cost < (keeps_weights ? FIXED_WEIGHTS_MIN_GAIN : PATH_MIN_GAIN) * cost)
        break;
    }
    if (!keeps_weights) outcome.end_cost = cost;
  }

  // Evaluates a pose with the current weights of the goals.
  void evaluate_weighted(int t, const double* q) {
    std::copy(q, q + coordinate_count_, state_.q.begin());
    compute_frames(task_.chain, state_.q.data(), state_.frames);
    measure(task_, weighted_targets(t), state_);
  }

  // Cost of a path; with `keeps_weights`, with the current weights of the goals.
  double evaluate(std::vector<double>& path, bool keeps_weights) {
    double cost = cost_.evaluate(anchors_.data(), path.data());
    for (int t = fit_.first; t < fit_.end; ++t) {
      if (keeps_weights) {
        evaluate_weighted(t, pose(path, t));
        double square = 0;
        for (int m = 0; m < task_.row_count; ++m)
          square += state_.residuals[m] * state_.residuals[m];
        cost += square / 2;
      } else {
        evaluate_pose(t, pose(path, t), state_);
        cost += robust_cost(t, state_, fit_.robust_scale);
      }
    }
    return cost;
  }

  // Computes the normal matrices and the negative gradient at the current path, with robust
  // weights, or with the current ones if `keeps_weights`.
  void assemble(bool keeps_weights) {
    const int count = fit_.end - fit_.first;
    cost_.evaluate(anchors_.data(), path_.data(), &path_gradient_);
    negative_gradients_.assign(static_cast<std::size_t>(count) * dof_count_, 0.0);
    normals_.resize(static_cast<std::size_t>(count) * dof_count_ * dof_count_);
    fixed_directions_.assign(count, {});
    max_stiffness_ = 0;
    for (int i = 0; i < count; ++i) {
      const int t = fit_.first + i;
      if (keeps_weights) {
        evaluate_weighted(t, pose(path_, t));
      } else {
        evaluate_pose(t, pose(path_, t), state_);
        reweight(t, state_, fit_.robust_scale);
        measure(task_, weighted_targets(t), state_);
      }
      differentiate(task_, weighted_targets(t), state_, linear_.columns);
      double* normal = normals_.data() + static_cast<std::size_t>(i) * dof_count_ * dof_count_;
      compute_normal_matrix(task_, linear_, normal);
      double* frame_negative_gradient =
          negative_gradients_.data() + static_cast<std::size_t>(i) * dof_count_;
      for (int d = 0; d < dof_count_; ++d) {
        const double* column =
            linear_.columns.data() + static_cast<std::size_t>(d) * task_.row_count;
        double sum = -row(path_gradient_, t)[d];
        for (int m = linear_.first_rows[d]; m < linear_.last_rows[d]; ++m)
          sum += column[m] * state_.residuals[m];
        frame_negative_gradient[d] = sum;
        double& diagonal = normal[static_cast<std::size_t>(d) * dof_count_ + d];
        diagonal += band_.entry(t, 0);
        max_stiffness_ = std::max(max_stiffness_, diagonal);
      }
      collect_blocked_limits(i, frame_negative_gradient);
    }
  }

  // Collects the limits that a step along the gradient would violate.
  void collect_blocked_limits(int i, const double* frame_negative_gradient) {
    std::fill(tangent_.begin(), tangent_.end(), 0.0);
    // Each joint separately: a small gradient component can violate a limit too.
    for (const Node& node : task_.chain.nodes) {
      if (node.is_driven) continue;
      double squared_length = 0;
      for (int k = 0; k < node.dof_count(); ++k)
        squared_length +=
            frame_negative_gradient[node.dof + k] * frame_negative_gradient[node.dof + k];
      for (int k = 0; k < node.dof_count() && squared_length > 0; ++k)
        tangent_[node.dof + k] =
            PROBE_STEP * frame_negative_gradient[node.dof + k] / std::sqrt(squared_length);
    }
    std::vector<Stepper::LimitFlags> at_limit;
    stepper_.fix_locked(state_, fixed_directions_[i], at_limit);
    stepper_.fix_violations(state_, tangent_.data(), fixed_directions_[i], at_limit);
  }

  // Computes next_path_, the path after a step; returns false if the step is not finite.
  bool try_path_step(double damping) {
    const int count = fit_.end - fit_.first;
    const double stiffness = LIMIT_STIFFNESS * max_stiffness_;
    const std::size_t block_size = static_cast<std::size_t>(dof_count_) * dof_count_;
    step_ = negative_gradients_;
    for (int i = 0; i < count; ++i) {
      double* block = blocks_.block(i);
      std::copy(normals_.data() + i * block_size, normals_.data() + (i + 1) * block_size, block);
      for (int d = 0; d < dof_count_; ++d) block[d * dof_count_ + d] += damping;
      for (const FixedDirection& fixed : fixed_directions_[i])
        for (int k = 0; k < fixed.width; ++k) {
          const int d = fixed.dof + k;
          for (int n = 0; n <= k; ++n)
            block[d * dof_count_ + fixed.dof + n] +=
                stiffness * fixed.direction[k] * fixed.direction[n];
          row(step_, i)[d] += stiffness * fixed.value * fixed.direction[k];
        }
    }
    if (!blocks_.factor()) return false;
    blocks_.solve(step_.data());
    next_path_ = path_;
    for (int i = 0; i < count; ++i) {
      double* frame_step = row(step_, i);
      double largest = 0;
      for (int d = 0; d < dof_count_; ++d) largest = std::max(largest, std::fabs(frame_step[d]));
      if (!std::isfinite(largest)) return false;
      for (int d = 0; d < dof_count_ && largest > MAX_ROTATION; ++d)
        frame_step[d] *= MAX_ROTATION / largest;
      stepper_.move(pose(path_, fit_.first + i), frame_step, pose(next_path_, fit_.first + i));
    }
    return true;
  }

  Task& mutable_task_;
  const double prediction_weight_;
  const FitSettings fit_;
  const int frame_count_, dof_count_, coordinate_count_;
  std::vector<double> source_targets_,
      weighted_targets_;  // targets, and the same with current weights
  const double* starts_;
  PathCost cost_;
  TimeBand band_;
  BlockBand blocks_;
  std::vector<double> rest_pose_, tangent_, start_, squared_errors_;
  std::vector<int> joint_flags_;
  std::vector<std::size_t> unmatched_goals_;
  std::int64_t* target_sources_ = nullptr;
  State state_;
  std::vector<double> path_, next_path_, anchors_, path_gradient_, negative_gradients_, normals_,
      step_;
  std::vector<std::vector<FixedDirection>> fixed_directions_;
  double max_stiffness_ = 0;
};

// Damping of the first step of a fit; its goals are not reached exactly.
constexpr double FIT_DAMPING = 1e-3;

}  // namespace

}  // namespace ik

using namespace ik;

IkFitResult fit_ik(const IkFitArguments& arguments) {
  const auto& [nodes, numbers, goals, goal_numbers, path, targets, starts, anchor, speed,
               acceleration, robust_scale, rest_weight, rest_return_fraction, first, end,
               iterations, rounds, solves_frames_first] = arguments;
  Task task = read_task(nodes, numbers, goals, goal_numbers, rest_weight);
  const std::size_t frame_count = path.shape(0), width = path.shape(1), goal_count = goals.shape(0);
  check_poses("path", task, frame_count, path);
  check_poses("starts", task, frame_count, starts);
  check::at_most("path", frame_count, check::MAX_ROWS);
  check_targets("targets", task, frame_count, targets);
  check::positive("anchor", anchor);
  check::non_negative("speed", speed);
  check::non_negative("acceleration", acceleration);
  check::between("homing", rest_return_fraction, 0, 1);
  if (!(robust_scale > 0)) check::refuse("robust", check::text(robust_scale) + " is not above 0");
  check::between("end", end, 0, frame_count);
  check::between("first", first, 0, end);
  check::between("iterations", iterations, 0, std::numeric_limits<int>::max());
  check::between("rounds", rounds, 0, std::numeric_limits<int>::max());
  const Settings settings{0, 0, FIT_DAMPING, iterations, 0, 0, 0, false};
  const FitSettings fit_settings{
      {anchor, speed, acceleration}, robust_scale, rest_return_fraction, static_cast<int>(first),
      static_cast<int>(end),         rounds,       solves_frames_first};
  Out<double, 2> fitted(frame_count, width);
  Out<double, 3> errors(frame_count, goal_count, COMPONENT_COUNT);
  Out<std::int64_t, 1> used_start_pose(frame_count);
  Out<std::int64_t, 2> target_sources(frame_count, goal_count);
  std::copy(path.data(), path.data() + frame_count * width, fitted.get());
  std::fill(used_start_pose.get(), used_start_pose.get() + frame_count, 0);
  PathFit fit(task, settings, fit_settings, static_cast<int>(frame_count), targets.data(),
              starts.data());
  for (std::size_t i = 0; i < frame_count * goal_count; ++i)
    target_sources.get()[i] = static_cast<std::int64_t>(i % goal_count);
  const FitOutcome outcome = fit.run(fitted.get(), used_start_pose.get(), target_sources.get());
  State state(task);
  for (std::size_t t = 0; t < frame_count; ++t) {
    std::copy(fitted.get() + t * width, fitted.get() + (t + 1) * width, state.q.begin());
    compute_frames(task.chain, state.q.data(), state.frames);
    measure(task, fit.targets(static_cast<int>(t)), state);
    std::copy(state.errors.begin(), state.errors.end(),
              errors.get() + t * goal_count * COMPONENT_COUNT);
  }
  return {std::move(fitted),         std::move(errors),  std::move(used_start_pose),
          std::move(target_sources), outcome.iterations, outcome.start_cost,
          outcome.end_cost};
}

}  // namespace animtool
