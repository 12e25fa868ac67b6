// The search with restarts, and prioritised goals.
#include "ik/levels.h"

namespace animtool::ik {

Status Search::run(const double* start, const double* targets, const double* rest,
                   bool is_next_frame) {
  was_unreached_ = is_next_frame && outcome_.status == Status::NEAREST;
  // Frames that continue a search start elsewhere each time.
  if (!was_unreached_) random_ = Random(settings_.seed);
  if (!begin_problem(start, targets, rest)) return outcome_.status = Status::NOT_FINITE;
  outcome_.status = search_all();
  previous_cost_ = best_.cost;
  previous_state_.q = best_.q;
  return outcome_.status;
}

void Search::refine(const double* targets, const double* residual_offsets, double min_gain) {
  set_targets(targets, residual_offsets);
  min_gain_ = std::max(min_gain, ROUNDING_MIN_GAIN);
  set_current(best_);
  descend(NEAR_GOAL_DAMPING, true);
  std::swap(current_, best_);
}

void Search::search(const double* targets) {
  set_targets(targets, nullptr);
  evaluate(best_);
  State previous_best = best_;
  best_.q = start_.q;
  evaluate(best_);
  was_unreached_ = false;
  search_all();
  if (!(best_.cost < previous_best.cost * IMPROVEMENT_RATIO)) std::swap(best_, previous_best);
}

Status Search::search_all() {
  min_cost_ = cost_lower_bound(task_, targets_, best_.frames);
  const bool has_tradeoffs = task_.rest_weight > 0 || task_.level_count > 1;
  min_gain_ = task_.level_count > 1 ? LEVEL_MIN_GAIN
              : has_tradeoffs       ? REST_MIN_GAIN
                                    : ROUNDING_MIN_GAIN;
  const bool is_thorough =
      min_cost_ > 0 || has_tradeoffs ||
      task_.chain.dof_count >= REDUNDANCY_RATIO * count_active_rows(task_, targets_);
  start_.q = best_.q;
  set_current(best_);
  const DescentEnd descent_end = descend(settings_.damping, is_thorough || was_unreached_);
  if (keep_better()) return Status::REACHED;
  if (was_unreached_ && settings_.has_separate_starts && continue_previous(is_thorough))
    return Status::REACHED;
  if (is_same_minimum(descent_end)) {
    const double best_cost = best_.cost;
    const int restarts =
        task_.level_count > 1 ? 0 : std::min(MAX_CONTINUED_STARTS, settings_.restarts);
    for (int i = 0; i < restarts && !is_budget_spent() && !is_known_minimum(); ++i) {
      sample_start(i % 2 ? best_ : start_);
      descend(NEW_START_DAMPING, is_thorough);
      if (current_.cost > best_cost * BRANCH_COST_RATIO && !is_reached(current_)) continue;
      if (keep_better()) return Status::REACHED;
    }
    if (best_.cost == best_cost) return Status::NEAREST;
  }
  const double exact_min_gain = min_gain_;
  const bool is_reached_by_restart = search_restarts(descent_end == DescentEnd::STUCK, is_thorough);
  min_gain_ = exact_min_gain;
  return is_reached_by_restart && !has_tradeoffs ? Status::REACHED : descend_to_minimum();
}

bool Search::search_restarts(bool is_stuck, bool is_thorough) {
  const double exact_min_gain = min_gain_;
  int agreeing_count = 0;
  const int max_agreeing_starts =
      stepper_.is_redundant() ? MAX_REDUNDANT_AGREEING_STARTS : MAX_AGREEING_STARTS;
  for (int i = 0; i < settings_.restarts && !is_budget_spent() && !is_known_minimum(); ++i) {
    begin_restart(i, is_stuck);
    min_gain_ = i == POLISH_START ? exact_min_gain : std::max(exact_min_gain, COMPARISON_MIN_GAIN);
    descend(NEW_START_DAMPING, is_thorough || i == POLISH_START);
    const double best_cost = best_.cost;
    if (current_.cost < best_cost * IMPROVEMENT_RATIO)
      agreeing_count = 0;
    else if (current_.cost < best_cost * (1 + 1e-2))
      ++agreeing_count;
    if (keep_better()) return true;
    if (agreeing_count >= max_agreeing_starts) break;
  }
  return false;
}

void Search::begin_restart(int i, bool is_stuck) {
  if (i == 0 && is_stuck) {
    set_current(best_);
    perturb();
  } else if (i == POLISH_START) {
    set_current(best_);
  } else if (i == 1) {
    start_from_zero();
  } else {
    sample_start(i % 2 ? best_ : start_);
  }
}

Status Search::descend_to_minimum() {
  if (is_budget_spent()) return Status::BUDGET;
  set_current(best_);
  const DescentEnd descent_end = descend(NEW_START_DAMPING, true);
  if (keep_better()) return Status::REACHED;
  return descent_end == DescentEnd::BUDGET ? Status::BUDGET : Status::NEAREST;
}

void Search::start_from_zero() {
  for (const Node& node : task_.chain.nodes) {
    if (node.program >= 0) continue;
    double* values = &current_.q[node.coordinate];
    std::fill(values, values + (node.kind == Kind::BALL ? 4 : 1), 0.0);
    if (node.kind == Kind::BALL) values[3] = 1;
  }
  perturb();
}

void Search::sample_start(const State& reference_pose) {
  double min_cost = std::numeric_limits<double>::infinity();
  for (int i = 0; i < START_SAMPLES; ++i) {
    sample_pose(task_.chain, reference_pose.q.data(), random_, next_.q.data());
    evaluate(next_);
    if (!(next_.cost < min_cost)) continue;
    min_cost = next_.cost;
    std::swap(current_, next_);
  }
}

Outcome PrioritySolver::run(const double* start, const double* targets, const double* rest,
                            bool is_next_frame) {
  targets_ = targets;
  const int last_level = task_.level_count - 1;
  set_weights(last_level, SEARCH_RATIO);
  search_.set_budget_fraction(last_level > 0 ? SEARCH_BUDGET : 1);
  Status status = search_.run(start, scaled_targets_.data(), rest, is_next_frame);
  search_.set_budget_fraction(1);
  if ((status == Status::NEAREST || status == Status::BUDGET) && last_level > 0) {
    const bool is_budget_spent = status == Status::BUDGET;
    status = separate_levels(is_next_frame && was_hard_unreached_);
    if (is_budget_spent && status == Status::NEAREST) status = Status::BUDGET;
  }
  was_hard_unreached_ = last_level > 0 && !is_level_reached(0);
  if (status == Status::NEAREST) status = diagnose();
  Outcome outcome = search_.outcome();
  outcome.status = status;
  return outcome;
}

void PrioritySolver::set_weights(int last_level, double ratio) {
  std::copy(targets_, targets_ + scaled_targets_.size(), scaled_targets_.begin());
  double fraction = 1;
  for (int level = 1; level < task_.level_count; ++level) {
    fraction *= ratio;
    const double level_weight = largest_weight(level), hard_weight = largest_weight(0);
    scale_level(level, level > last_level ? 0
                                          : fraction * (level_weight > 0 && hard_weight > 0
                                                            ? hard_weight / level_weight
                                                            : 1));
  }
  task_.rest_weight = last_level == task_.level_count - 1 ? rest_weight_ * fraction * fraction : 0;
}

double PrioritySolver::largest_weight(int level) const {
  double largest = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    if (task_.goals[e].level == level)
      for (int component = 0; component < COMPONENT_COUNT; ++component)
        largest =
            std::max(largest, weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, component));
  return largest;
}

Status PrioritySolver::separate_levels(bool was_unreached) {
  std::fill(residual_offsets_.begin(), residual_offsets_.end(), 0.0);
  std::fill(is_constrained_.begin(), is_constrained_.end(), false);
  for (int level = 0; level < task_.level_count && !search_.is_budget_spent(); ++level) {
    set_weights(level, weight_ratio_);
    for (int i = 0; i < MAX_OFFSET_UPDATES; ++i) {
      search_.refine(scaled_targets_.data(), residual_offsets_.data(),
                     LEVEL_PRECISION * std::pow(weight_ratio_, 2 * level));
      if (search_.is_budget_spent() || !update_offsets()) break;
    }
    if (level == 0 && !was_unreached && !is_level_reached(0))
      search_.search(scaled_targets_.data());
    is_constrained_[level] = is_level_reached(level);
  }
  const bool is_budget_spent = search_.is_budget_spent();
  if (!is_budget_spent) restore_levels();
  search_.reevaluate(targets_);
  if (is_budget_spent) return Status::BUDGET;
  return search_.is_reached(best()) ? Status::REACHED : Status::NEAREST;
}

bool PrioritySolver::update_offsets() {
  bool has_drifted = false;
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    has_drifted = has_drifted || (is_constrained_[task_.goals[e].level] &&
                                  !search_.is_within_tolerance(&best().errors[COMPONENT_COUNT * e],
                                                               LEVEL_TOLERANCE));
  if (!has_drifted) return false;
  for (const Goal& goal : task_.goals)
    if (is_constrained_[goal.level])
      for (int i = goal.row; i < goal.row + count_rows(goal); ++i)
        residual_offsets_[i] = best().residuals[i];
  return true;
}

void PrioritySolver::restore_levels() {
  bool has_drifted = false;
  set_weights(task_.level_count - 1, weight_ratio_);
  task_.rest_weight = 0;
  for (int level = 0; level < task_.level_count; ++level) {
    has_drifted = has_drifted || (is_constrained_[level] && !is_level_reached(level));
    if (!is_constrained_[level]) scale_level(level, 0);
  }
  if (has_drifted) search_.refine(scaled_targets_.data(), nullptr, 0);
}

Status PrioritySolver::diagnose() {
  const bool is_hard_reached = is_level_reached(0);
  if (!is_hard_reached && rest_weight_ > 0) {
    set_weights(0, 1);
    task_.rest_weight = 0;
    if (search_.can_reach(scaled_targets_.data())) return Status::SOFTENED;
  }
  if (count_active_goals() < 2) return Status::NEAREST;
  for (const std::size_t e : find_missed_goals()) {
    isolate_goal(e);
    if (!search_.can_reach(scaled_targets_.data())) return Status::NEAREST;
  }
  return is_hard_reached ? Status::SOFTENED : Status::CONFLICT;
}

int PrioritySolver::count_active_goals() const {
  int count = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e) {
    bool is_active = false;
    for (int component = 0; component < COMPONENT_COUNT; ++component)
      is_active =
          is_active || weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, component) > 0;
    count += is_active;
  }
  return count;
}

std::vector<std::size_t> PrioritySolver::find_missed_goals() const {
  std::vector<std::size_t> missed_goals;
  const std::vector<double>& errors = best().errors;
  const auto max_error = [&](std::size_t e) {
    return *std::max_element(&errors[COMPONENT_COUNT * e],
                             &errors[COMPONENT_COUNT * e] + COMPONENT_COUNT);
  };
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    if (!search_.is_within_tolerance(&errors[COMPONENT_COUNT * e])) missed_goals.push_back(e);
  std::sort(missed_goals.begin(), missed_goals.end(),
            [&](std::size_t a, std::size_t b) { return max_error(a) > max_error(b); });
  return missed_goals;
}

}  // namespace animtool::ik
