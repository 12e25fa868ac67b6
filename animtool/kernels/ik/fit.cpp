// Fits the poses of a clip to weighted goals: robust to outliers, smooth in time, and within the
// limits.
//
// Over all frames at once: min sum rho(|r|) + speed |v|^2 / 2 + acceleration |a|^2 / 2, with
// rho(r) = r^2 / 2 / (1 + r^2 / c^2) (S. Geman, D. McClure, Statistical methods for
// tomographic image reconstruction, 1987) for each goal, by reweighted Gauss-Newton. Before that,
// frames are solved one after the other, each from a pose extrapolated from earlier frames, with c
// decreasing from the residuals there (A. Blake, A. Zisserman, Visual reconstruction, 1987).
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
  double robust;   // c, in units of weighted residuals; infinite for least squares
  double homing;   // fraction of the way to its rest that an unconstrained joint moves per frame
  int first, end;  // frames that may move
  int rounds;      // largest number of Gauss-Newton iterations over all frames
  bool tracked;    // frames are solved one after the other first
};

struct FitOutcome {
  int rounds = 0;
  double before = 0, after = 0;
};

class PathFit : public Descent {
 public:
  // `starts` (F, Q) are start poses of frames for which extrapolation from earlier frames fails.
  // The task's rest weight is the weight of the extrapolated pose.
  PathFit(Task& task, const Settings& settings, const FitSettings& fit, int frames,
          const double* targets, const double* starts)
      : Descent(task, settings),
        local_task_(task),
        drawn_(task.rest_weight),
        fit_(fit),
        frames_(frames),
        width_(task.chain.dofs),
        coordinates_(task.chain.coordinates),
        source_targets_(targets, targets + frames * task.goals.size() * TARGET_WIDTH),
        asked_(source_targets_),
        starts_(starts),
        cost_(task.chain, frames, fit.weights, nullptr),
        band_(frames, fit.first, fit.end, fit.weights),
        blocks_(width_),
        home_(task.chain.coordinates),
        away_(width_),
        kept_(task) {
    least_gain_ = ENOUGH;
    for (const Node& node : task.chain.nodes)
      if (node.kind == Kind::BALL && !node.follows) home_[node.coordinate + 3] = 1;
  }

  // Targets (F, E, W), after exchanges between goals.
  const double* targets(int t) const { return source_targets(t); }

  // Improves a path (F, Q) in place. `searched` (F,) tells which frames used their start pose, and
  // `taken` (F, E) from which goal a goal took its target, -1 if it lost its own and took none.
  FitOutcome run(double* path, std::int64_t* searched, std::int64_t* taken) {
    taken_ = taken;
    now_path_.assign(path, path + static_cast<std::size_t>(frames_) * coordinates_);
    if (fit_.tracked)
      for (int t = fit_.first; t < fit_.end; ++t) searched[t] = track(t);
    anchors_ = now_path_;
    FitOutcome outcome;
    minimize(outcome);
    std::copy(now_path_.begin(), now_path_.end(), path);
    return outcome;
  }

 private:
  // Smallest relative gain of a step in one frame, and of an iteration over all frames.
  static constexpr double ENOUGH = 1e-5, ROUND = 1e-4;
  // The same while fitting goals are held, to find only a start.
  static constexpr double NEAR = 0.01;
  // Squares of larger residuals overflow.
  static constexpr double BEYOND = 1e100;
  // Residuals above this multiple of their median at a start are probably outliers. The factor is
  // halved in each descent, at most this often.
  static constexpr double WIDER = 3;
  static constexpr int HALVINGS = 8;
  // A frame whose goals cost more than this fraction of their largest cost, on average, is searched
  // from this many other starts; a result has to cost less than this fraction of the previous cost.
  static constexpr double LOST = 0.45, BETTER = 0.8;
  static constexpr int SEEDS = 4;
  // Weight of the start pose in a search from another start: unconstrained joints stay there.
  static constexpr double LOOSE = 1;
  // A target is stray if its squared error exceeds this multiple of c^2. It belongs to another goal
  // that is within this multiple of c, and nearer by this factor. If more than this many are
  // stray, the pose is wrong, not the targets.
  static constexpr double STRAY = 2, CLOSE = 2, NEARER = 0.25;
  static constexpr std::size_t MAX_STRAYS = 16;
  // This many goals outweigh the pose extrapolated from earlier frames.
  static constexpr double DOUBT = 3;
  // Fraction of the velocity that is kept per frame without observations.
  static constexpr double SLOWED = 0.9;
  // Attempts per iteration, and the factor of the damping from one to the next.
  static constexpr int TRIES = 6;
  static constexpr double STIFFER = 10;
  // Step along the gradient that tests whether a limit blocks a joint [rad].
  static constexpr double PROBE = 1e-6;
  // Stiffness of a limit, relative to the stiffest degree of freedom.
  static constexpr double WALL = 1e6;

  double* pose(std::vector<double>& of, int t) {
    return of.data() + static_cast<std::size_t>(t) * coordinates_;
  }
  double* row(std::vector<double>& of, int t) {
    return of.data() + static_cast<std::size_t>(t) * width_;
  }
  double* asked(int t) {
    return asked_.data() + static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }
  double* source_targets(int t) {
    return source_targets_.data() + static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }
  const double* source_targets(int t) const {
    return source_targets_.data() + static_cast<std::size_t>(t) * task_.goals.size() * TARGET_WIDTH;
  }

  // Calls f(goal, part, squared weighted error) for all parts of goals with a weight in a frame.
  template <class F>
  void each_miss(int t, const State& state, F&& f) const {
    for (std::size_t e = 0; e < task_.goals.size(); ++e)
      for (int part = 0; part < PARTS; ++part) {
        const double weight = weight_of(task_.goals[e], source_targets(t) + TARGET_WIDTH * e, part);
        if (!(weight > 0)) continue;
        const double error = weight * state.errors[PARTS * e + part];
        // Poses and targets may contain any numbers: NaN counts as far away.
        f(e, part, std::fabs(error) < BEYOND ? error * error : BEYOND * BEYOND);
      }
  }

  // Cost of the goals of a frame at a pose: at most c^2 / 2 each.
  double robust_cost(int t, const State& state, double scale) const {
    double cost = 0;
    each_miss(t, state, [&](std::size_t, int, double square) {
      cost += square / 2 / (1 + square / (scale * scale));
    });
    return cost;
  }

  // Cost of the goals of a frame, as a fraction of the largest possible cost.
  double cost_fraction(int t, const State& state) const {
    double sum = 0;
    int count = 0;
    const double limit = fit_.robust * fit_.robust;
    each_miss(t, state,
              [&](std::size_t, int, double square) { sum += square / (limit + square), ++count; });
    return count ? sum / count : 0;
  }

  // Robust weights of the goals, from their errors.
  void reweight(int t, const State& state, double scale) {
    double* out = asked(t);
    each_miss(t, state, [&](std::size_t e, int part, double square) {
      out[TARGET_WIDTH * e + WEIGHTS + part] =
          source_targets(t)[TARGET_WIDTH * e + WEIGHTS + part] / (1 + square / (scale * scale));
    });
  }

  double median_miss(int t, const State& state) {
    sizes_.clear();
    each_miss(t, state, [&](std::size_t, int, double square) { sizes_.push_back(square); });
    if (sizes_.empty()) return 0;
    std::nth_element(sizes_.begin(), sizes_.begin() + sizes_.size() / 2, sizes_.end());
    return std::sqrt(sizes_[sizes_.size() / 2]);
  }

  // A state with the errors of all goals that have targets, even if their weight is 0.
  void look(int t, const double* q, State& state) {
    std::copy(q, q + coordinates_, state.q.begin());
    forward(task_.chain, state.q.data(), state.frames);
    measure(task_, source_targets(t), state);
  }

  double largest_miss(int t, const State& state) const {
    double most = 0;
    each_miss(t, state, [&](std::size_t, int, double square) { most = std::max(most, square); });
    return std::sqrt(most);
  }

  // Cost of a pose's distance from the extrapolated pose; at most that of DOUBT goals.
  double surprise(const double* q, const double* predicted) {
    difference(task_.chain, predicted, q, away_.data());
    double square = 0;
    for (const double x : away_) square += x * x;
    const double cost = drawn_ * square / 2, most = DOUBT * fit_.robust * fit_.robust / 2;
    return std::isfinite(most) ? cost / (1 + cost / most) : cost;
  }

  // kept_ <- the pose at which a descent from a start ends; returns the cost of its goals. Errors
  // at the start above a scale count little at first.
  double settle(int t, const double* start, const double* prefer, bool all) {
    look(t, start, kept_);
    double scale = all ? largest_miss(t, kept_) : WIDER * median_miss(t, kept_);
    scale = std::max(fit_.robust, scale);
    local_task_.rest_weight = all ? std::min(LOOSE, drawn_) : drawn_;
    begun_.assign(start, start + coordinates_);
    for (int i = 0; i < HALVINGS; ++i) {
      reweight(t, kept_, scale);
      if (!open(begun_.data(), asked(t), prefer)) break;
      begin(best_);
      descend(settings_.damping, false);
      if (now_.cost < best_.cost) std::swap(now_, best_);
      std::copy(best_.q.begin(), best_.q.end(), begun_.data());
      look(t, begun_.data(), kept_);
      if (!(scale > fit_.robust)) break;
      scale = std::max(fit_.robust, std::min(scale / 2, WIDER * median_miss(t, kept_)));
    }
    return robust_cost(t, kept_, fit_.robust);
  }

  // Extrapolates a pose from earlier frames.
  void predict(int t, double* out) {
    const double* last = pose(now_path_, t - 1);
    std::fill(away_.begin(), away_.end(), 0.0);
    if (t > 1) difference(task_.chain, pose(now_path_, t - 2), last, away_.data());
    for (double& x : away_) x *= SLOWED;
    stepper_.move(last, away_.data(), out);
  }

  // The same for unconstrained joints, which return to their rest pose in time.
  void send_home(double* out) {
    difference(task_.chain, out, home_.data(), away_.data());
    for (const Node& node : task_.chain.nodes)
      for (int k = 0; k < (node.program < 0 ? node.width() : 0); ++k)
        away_[node.dof + k] *= node.kind == Kind::SLIDE || is_root(node) ? 0 : fit_.homing;
    stepper_.move(std::vector<double>(out, out + coordinates_).data(), away_.data(), out);
  }

  // now_path_ at t <- the fitted pose; returns 1 if it was not reached from earlier frames.
  std::int64_t track(int t) {
    std::vector<double> start(coordinates_), prefer(coordinates_);
    const double* restart = starts_ + static_cast<std::size_t>(t) * coordinates_;
    const bool follows = t > 0;
    if (follows)
      predict(t, start.data());
    else
      std::copy(restart, restart + coordinates_, start.begin());
    prefer = start;
    if (follows) send_home(prefer.data());
    if (follows && std::isfinite(fit_.robust)) exchange(t, start.data());
    double cost = settle(t, start.data(), prefer.data(), !follows);
    std::vector<double> best = kept_.q;
    std::int64_t searched = !follows;
    if (follows && largest_miss(t, kept_) > fit_.robust) {
      const double current_cost = cost + surprise(best.data(), prefer.data());
      const double other = settle(t, start.data(), prefer.data(), true);
      if (other + surprise(kept_.q.data(), prefer.data()) < current_cost)
        cost = other, best = kept_.q;
      look(t, best.data(), kept_);
    }
    if (send_torn_home(t, best, start)) {
      const double other = settle(t, start.data(), start.data(), true);
      if (other < cost) cost = other, best = kept_.q;
      look(t, best.data(), kept_);
    }
    if (cost_fraction(t, kept_) > LOST) {
      for (int i = 0; i < SEEDS; ++i) {
        std::copy(restart, restart + coordinates_, start.begin());
        if (i > 0) scatter(start);
        const double other = settle(t, start.data(), start.data(), true);
        if (!(other < BETTER * cost)) continue;
        cost = other, best = kept_.q, searched = 1;
      }
    }
    std::copy(best.begin(), best.end(), pose(now_path_, t));
    return searched;
  }

  // `out` <- a pose in which joints are at rest if all goals that they move are far off, such as
  // those of a neck whose head is lost; returns false if there are no such joints.
  bool send_torn_home(int t, const std::vector<double>& pose, std::vector<double>& out) {
    torn_.assign(task_.chain.nodes.size(), 0);
    const double limit = fit_.robust * fit_.robust;
    each_miss(t, kept_, [&](std::size_t e, int, double square) {
      for (const int n : task_.goals[e].path) torn_[n] |= square > limit ? 1 : 2;
    });
    out = pose;
    bool matched = false;
    for (std::size_t n = 0; n < torn_.size(); ++n) {
      const Node& node = task_.chain.nodes[n];
      if (torn_[n] != 1 || node.follows || node.kind == Kind::SLIDE || is_root(node)) continue;
      const int size = node.kind == Kind::BALL ? 4 : 1;
      std::copy(home_.begin() + node.coordinate, home_.begin() + node.coordinate + size,
                out.begin() + node.coordinate);
      matched = true;
    }
    return matched;
  }

  // Reassigns targets whose labels were mixed up: a target at the extrapolated position of another
  // goal, which has no target or is far from it, is given to that goal.
  void exchange(int t, const double* start) {
    look(t, start, kept_);
    strays_.clear();
    const double limit = fit_.robust * fit_.robust;
    for (std::size_t e = 0; e < task_.goals.size(); ++e) {
      if (!(task_.goals[e].weights[0] > 0)) continue;
      const double weight = weight_of(task_.goals[e], source_targets(t) + TARGET_WIDTH * e, 0);
      const double error = weight * kept_.errors[PARTS * e];
      if (!(weight > 0) || error * error > STRAY * limit) strays_.push_back(e);
    }
    if (strays_.size() < 2 || strays_.size() > MAX_STRAYS) return;
    std::int64_t* taken = taken_ + static_cast<std::size_t>(t) * task_.goals.size();
    const std::vector<double> before(source_targets(t),
                                     source_targets(t) + task_.goals.size() * TARGET_WIDTH);
    for (const std::size_t from : strays_) {
      const double* target = before.data() + TARGET_WIDTH * from;
      if (!(target[WEIGHTS] > 0)) continue;
      const double reach = CLOSE * fit_.robust / weight_of(task_.goals[from], target, 0);
      double least = std::min(reach, NEARER * away(from, target));
      std::size_t nearest = from;
      for (const std::size_t to : strays_) {
        const double* current_cost = before.data() + TARGET_WIDTH * to;
        const bool free = taken[to] < 0 || taken[to] == static_cast<std::int64_t>(to);
        const double other = away(to, target);
        if (to == from || !free || other > least) continue;
        if (current_cost[WEIGHTS] > 0 && other > NEARER * away(to, current_cost)) continue;
        least = other, nearest = to;
      }
      if (nearest == from) continue;
      double* out = source_targets(t) + TARGET_WIDTH * nearest;
      std::copy(target, target + 3, out);
      out[WEIGHTS] = target[WEIGHTS];
      taken[nearest] = static_cast<std::int64_t>(from);
      if (taken[from] != static_cast<std::int64_t>(from)) continue;
      // Until another target is found for it.
      source_targets(t)[TARGET_WIDTH * from + WEIGHTS] = 0;
      taken[from] = -1;
    }
    std::copy(source_targets(t), source_targets(t) + task_.goals.size() * TARGET_WIDTH, asked(t));
  }

  // Distance of a target from a goal's point at kept_.
  double away(std::size_t e, const double* target) const {
    const double* point = &kept_.points[3 * e];
    const double by[3] = {target[0] - point[0], target[1] - point[1], target[2] - point[2]};
    return length(by);
  }

  // Other poses of all joints except the root.
  void scatter(std::vector<double>& q) {
    std::vector<double> other(q.size());
    sample(task_.chain, q.data(), random_, other.data());
    for (const Node& node : task_.chain.nodes) {
      if (node.follows || node.kind == Kind::SLIDE || is_root(node)) continue;
      const int size = node.kind == Kind::BALL ? 4 : 1;
      std::copy(other.begin() + node.coordinate, other.begin() + node.coordinate + size,
                q.begin() + node.coordinate);
    }
  }

  bool is_root(const Node& node) const {
    for (int n = node.parent; n >= 0; n = task_.chain.nodes[n].parent)
      if (task_.chain.nodes[n].kind != Kind::SLIDE) return false;
    return true;
  }

  void minimize(FitOutcome& outcome) {
    if (fit_.first >= fit_.end) return;
    const int count = fit_.end - fit_.first;
    blocks_.resize(count);
    for (int i = 0; i < count; ++i)
      blocks_.couple(i, band_.entry(fit_.first + i, -1), band_.entry(fit_.first + i, -2));
    outcome.before = outcome.after = evaluate(now_path_, false);
    // Frames solved one by one are not smooth. The first smoothing step is long, and would lose
    // goals, whose weight falls with their error. So goals that fit now are held at first.
    if (fit_.tracked && std::isfinite(fit_.robust)) {
      for (int t = fit_.first; t < fit_.end; ++t) {
        look(t, pose(now_path_, t), kept_);
        reweight(t, kept_, fit_.robust);
      }
      improve(outcome, true);
    }
    improve(outcome, false);
  }

  // Steps of all frames at once. With `held`, goals keep the weights in `asked_`.
  void improve(FitOutcome& outcome, bool keep_weights) {
    double cost = evaluate(now_path_, keep_weights), damping = 0;
    for (int round = 0; round < fit_.rounds; ++round) {
      assemble(keep_weights);
      const double before = cost;
      bool better = false;
      for (int i = 0; i < TRIES && !better; ++i) {
        if (attempt(damping)) {
          const double next = evaluate(next_path_, keep_weights);
          better = next < cost;
          if (better) cost = next, now_path_.swap(next_path_);
        }
        damping = better ? damping / STIFFER : std::max(damping, 1e-6 * stiffest_) * STIFFER;
      }
      if (!better) break;
      ++outcome.rounds;
      if (before - cost < (keep_weights ? NEAR : ROUND) * cost) break;
    }
    if (!keep_weights) outcome.after = cost;
  }

  // A state with the residuals of goals weighted as in `asked_`.
  void look_as_asked(int t, const double* q) {
    std::copy(q, q + coordinates_, kept_.q.begin());
    forward(task_.chain, kept_.q.data(), kept_.frames);
    measure(task_, asked(t), kept_);
  }

  double evaluate(std::vector<double>& path, bool keep_weights) {
    double cost = cost_.evaluate(anchors_.data(), path.data());
    for (int t = fit_.first; t < fit_.end; ++t) {
      if (keep_weights) {
        look_as_asked(t, pose(path, t));
        double square = 0;
        for (int m = 0; m < task_.rows; ++m) square += kept_.residuals[m] * kept_.residuals[m];
        cost += square / 2;
      } else {
        look(t, pose(path, t), kept_);
        cost += robust_cost(t, kept_, fit_.robust);
      }
    }
    return cost;
  }

  // Computes blocks_ and downhill_ at the current path, with robust weights, or fixed ones if
  // `held`.
  void assemble(bool keep_weights) {
    const int count = fit_.end - fit_.first;
    cost_.evaluate(anchors_.data(), now_path_.data(), &slope_);
    downhill_.assign(static_cast<std::size_t>(count) * width_, 0.0);
    normals_.resize(static_cast<std::size_t>(count) * width_ * width_);
    walls_.assign(count, {});
    stiffest_ = 0;
    for (int i = 0; i < count; ++i) {
      const int t = fit_.first + i;
      if (keep_weights) {
        look_as_asked(t, pose(now_path_, t));
      } else {
        look(t, pose(now_path_, t), kept_);
        reweight(t, kept_, fit_.robust);
        measure(task_, asked(t), kept_);
      }
      differentiate(task_, asked(t), kept_, linear_.columns);
      double* normal = normals_.data() + static_cast<std::size_t>(i) * width_ * width_;
      multiply_columns(task_, linear_, normal);
      double* down = downhill_.data() + static_cast<std::size_t>(i) * width_;
      for (int d = 0; d < width_; ++d) {
        const double* column = linear_.columns.data() + static_cast<std::size_t>(d) * task_.rows;
        double sum = -row(slope_, t)[d];
        for (int m = linear_.first[d]; m < linear_.last[d]; ++m)
          sum += column[m] * kept_.residuals[m];
        down[d] = sum;
        double& current_cost = normal[static_cast<std::size_t>(d) * width_ + d];
        current_cost += band_.entry(t, 0);
        stiffest_ = std::max(stiffest_, current_cost);
      }
      stop(i, down);
    }
  }

  // Limits that the gradient step would violate.
  void stop(int i, const double* down) {
    std::fill(away_.begin(), away_.end(), 0.0);
    // Each joint separately: a small gradient component can violate a limit too.
    for (const Node& node : task_.chain.nodes) {
      if (node.follows) continue;
      double size = 0;
      for (int k = 0; k < node.width(); ++k) size += down[node.dof + k] * down[node.dof + k];
      for (int k = 0; k < node.width() && size > 0; ++k)
        away_[node.dof + k] = PROBE * down[node.dof + k] / std::sqrt(size);
    }
    std::vector<Stepper::AtLimit> at_limit;
    stepper_.fix_locked(kept_, walls_[i], at_limit);
    stepper_.fix_violations(kept_, away_.data(), walls_[i], at_limit);
  }

  // next_path_ <- the path after a step.
  bool attempt(double damping) {
    const int count = fit_.end - fit_.first;
    const double wall = WALL * stiffest_;
    const std::size_t square = static_cast<std::size_t>(width_) * width_;
    step_ = downhill_;
    for (int i = 0; i < count; ++i) {
      double* block = blocks_.block(i);
      std::copy(normals_.data() + i * square, normals_.data() + (i + 1) * square, block);
      for (int d = 0; d < width_; ++d) block[d * width_ + d] += damping;
      for (const Fixed& fixed : walls_[i])
        for (int k = 0; k < fixed.width; ++k) {
          const int d = fixed.dof + k;
          for (int n = 0; n <= k; ++n)
            block[d * width_ + fixed.dof + n] += wall * fixed.direction[k] * fixed.direction[n];
          row(step_, i)[d] += wall * fixed.value * fixed.direction[k];
        }
    }
    if (!blocks_.factor()) return false;
    blocks_.solve(step_.data());
    next_path_ = now_path_;
    for (int i = 0; i < count; ++i) {
      double* by = row(step_, i);
      double longest = 0;
      for (int d = 0; d < width_; ++d) longest = std::max(longest, std::fabs(by[d]));
      if (!std::isfinite(longest)) return false;
      for (int d = 0; d < width_ && longest > MAX_ROTATION; ++d) by[d] *= MAX_ROTATION / longest;
      stepper_.move(pose(now_path_, fit_.first + i), by, pose(next_path_, fit_.first + i));
    }
    return true;
  }

  Task& local_task_;
  const double drawn_;
  const FitSettings fit_;
  const int frames_, width_, coordinates_;
  std::vector<double> source_targets_, asked_;  // targets, and the same with current weights
  const double* starts_;
  PathCost cost_;
  TimeBand band_;
  BlockBand blocks_;
  std::vector<double> home_, away_, begun_, sizes_;
  std::vector<int> torn_;
  std::vector<std::size_t> strays_;
  std::int64_t* taken_ = nullptr;
  State kept_;
  std::vector<double> now_path_, next_path_, anchors_, slope_, downhill_, normals_, step_;
  std::vector<std::vector<Fixed>> walls_;
  double stiffest_ = 0;
};

// Damping of the first step of a fit, whose goals are never reached exactly.
constexpr double FIT_DAMPING = 1e-3;

}  // namespace

}  // namespace ik

using namespace ik;

IkFitted fit_ik(const IkFitting& source_targets) {
  const auto& [nodes, numbers, goals, goal_numbers, path, targets, starts, anchor, speed,
               acceleration, robust, rest_weight, homing, first, end, iterations, rounds, tracked] =
      source_targets;
  Task task = read_task(nodes, numbers, goals, goal_numbers, rest_weight);
  const std::size_t frames = path.shape(0), width = path.shape(1), e = goals.shape(0);
  check_poses("path", task, frames, path);
  check_poses("starts", task, frames, starts);
  check::at_most("path", frames, check::MAX_ROWS);
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
  const FitSettings over{{anchor, speed, acceleration}, robust, homing, static_cast<int>(first),
                         static_cast<int>(end),         rounds, tracked};
  Out<double, 2> fitted(frames, width);
  Out<double, 3> errors(frames, e, PARTS);
  Out<std::int64_t, 1> searched(frames);
  Out<std::int64_t, 2> taken(frames, e);
  std::copy(path.data(), path.data() + frames * width, fitted.get());
  std::fill(searched.get(), searched.get() + frames, 0);
  PathFit fit(task, settings, over, static_cast<int>(frames), targets.data(), starts.data());
  for (std::size_t i = 0; i < frames * e; ++i) taken.get()[i] = static_cast<std::int64_t>(i % e);
  const FitOutcome outcome = fit.run(fitted.get(), searched.get(), taken.get());
  State state(task);
  for (std::size_t t = 0; t < frames; ++t) {
    std::copy(fitted.get() + t * width, fitted.get() + (t + 1) * width, state.q.begin());
    forward(task.chain, state.q.data(), state.frames);
    measure(task, fit.targets(static_cast<int>(t)), state);
    std::copy(state.errors.begin(), state.errors.end(), errors.get() + t * e * PARTS);
  }
  return {std::move(fitted), std::move(errors), std::move(searched), std::move(taken),
          outcome.rounds,    outcome.before,    outcome.after};
}

}  // namespace animtool
