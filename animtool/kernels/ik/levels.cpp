// The search with restarts, and prioritised goals.
#include "ik/levels.h"

namespace animtool::ik {

Status Search::run(const double* start, const double* targets, const double* rest, bool next) {
  last_unreached_ = next && outcome_.status == Status::NEAREST;
  // Frames that continue a search start elsewhere each time.
  if (!last_unreached_) random_ = Random(settings_.seed);
  if (!open(start, targets, rest)) return outcome_.status = Status::BROKEN;
  outcome_.status = search_all();
  last_cost_ = best_.cost;
  last_.q = best_.q;
  return outcome_.status;
}

void Search::refine(const double* targets, const double* shift, double least_gain) {
  set_targets(targets, shift);
  least_gain_ = std::max(least_gain, ROUNDED);
  begin(best_);
  descend(WARM, true);
  std::swap(now_, best_);
}

void Search::search(const double* targets) {
  set_targets(targets, nullptr);
  evaluate(best_);
  State kept = best_;
  best_.q = first_.q;
  evaluate(best_);
  last_unreached_ = false;
  search_all();
  if (!(best_.cost < kept.cost * BETTER)) std::swap(best_, kept);
}

Status Search::search_all() {
  floor_ = nearest_cost(task_, targets_, best_.frames);
  const bool mixed = task_.rest_weight > 0 || task_.levels > 1;
  least_gain_ = task_.levels > 1 ? ROUGH : mixed ? FINE : ROUNDED;
  const bool is_thorough =
      floor_ > 0 || mixed || task_.chain.dofs >= REDUNDANT * rows_asked(task_, targets_);
  first_.q = best_.q;
  begin(best_);
  const End end = descend(settings_.damping, is_thorough || last_unreached_);
  if (accept()) return Status::REACHED;
  if (last_unreached_ && settings_.separate_starts && continue_last(is_thorough))
    return Status::REACHED;
  if (is_same_miss(end)) {
    const double before = best_.cost;
    const int restarts = task_.levels > 1 ? 0 : std::min(RESTARTS_NEXT, settings_.restarts);
    for (int i = 0; i < restarts && !spent() && !is_minimal(); ++i) {
      sample_start(i % 2 ? best_ : first_);
      descend(COLD, is_thorough);
      if (now_.cost > before * JUMP && !reached(now_)) continue;
      if (accept()) return Status::REACHED;
    }
    if (best_.cost == before) return Status::NEAREST;
  }
  const double exact = least_gain_;
  const bool restart_reached = search_restarts(end == End::STUCK, is_thorough);
  least_gain_ = exact;
  return restart_reached && !mixed ? Status::REACHED : polish();
}

bool Search::search_restarts(bool stalled, bool is_thorough) {
  const double exact = least_gain_;
  int agreeing = 0;
  const int enough = stepper_.abundant() ? FEW : AGREEING;
  for (int i = 0; i < settings_.restarts && !spent() && !is_minimal(); ++i) {
    restart(i, stalled);
    least_gain_ = i == POLISHED ? exact : std::max(exact, COMPARED);
    descend(COLD, is_thorough || i == POLISHED);
    const double before = best_.cost;
    if (now_.cost < before * BETTER)
      agreeing = 0;
    else if (now_.cost < before * (1 + 1e-2))
      ++agreeing;
    if (accept()) return true;
    if (agreeing >= enough) break;
  }
  return false;
}

void Search::restart(int i, bool stalled) {
  if (i == 0 && stalled) {
    begin(best_);
    perturb();
  } else if (i == POLISHED) {
    begin(best_);
  } else if (i == 1) {
    straighten();
  } else {
    sample_start(i % 2 ? best_ : first_);
  }
}

Status Search::polish() {
  if (spent()) return Status::BUDGET;
  begin(best_);
  const End end = descend(COLD, true);
  if (accept()) return Status::REACHED;
  return end == End::BUDGET ? Status::BUDGET : Status::NEAREST;
}

void Search::straighten() {
  for (const Node& node : task_.chain.nodes) {
    if (node.program >= 0) continue;
    double* values = &now_.q[node.coordinate];
    std::fill(values, values + (node.kind == Kind::BALL ? 4 : 1), 0.0);
    if (node.kind == Kind::BALL) values[3] = 1;
  }
  perturb();
}

void Search::sample_start(const State& home) {
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < SAMPLES; ++i) {
    sample(task_.chain, home.q.data(), random_, next_.q.data());
    evaluate(next_);
    if (!(next_.cost < least)) continue;
    least = next_.cost;
    std::swap(now_, next_);
  }
}

Outcome Levels::run(const double* start, const double* targets, const double* rest, bool next) {
  targets_ = targets;
  const int last = task_.levels - 1;
  set_weights(last, SEARCH_RATIO);
  search_.allow(last > 0 ? SEARCH_BUDGET : 1);
  Status status = search_.run(start, scaled_.data(), rest, next);
  search_.allow(1);
  if ((status == Status::NEAREST || status == Status::BUDGET) && last > 0) {
    const bool cut = status == Status::BUDGET;
    status = separate_levels(next && last_unreached_);
    if (cut && status == Status::NEAREST) status = Status::BUDGET;
  }
  last_unreached_ = last > 0 && !within(0);
  if (status == Status::NEAREST) status = diagnose();
  Outcome outcome = search_.outcome();
  outcome.status = status;
  return outcome;
}

void Levels::set_weights(int last, double ratio) {
  std::copy(targets_, targets_ + scaled_.size(), scaled_.begin());
  double fraction = 1;
  for (int level = 1; level < task_.levels; ++level) {
    fraction *= ratio;
    const double values = largest_weight(level), hard = largest_weight(0);
    scale(level, level > last ? 0 : fraction * (values > 0 && hard > 0 ? hard / values : 1));
  }
  task_.rest_weight = last == task_.levels - 1 ? rest_weight_ * fraction * fraction : 0;
}

double Levels::largest_weight(int level) const {
  double most = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    if (task_.goals[e].level == level)
      for (int part = 0; part < PARTS; ++part)
        most = std::max(most, weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, part));
  return most;
}

Status Levels::separate_levels(bool was_unreached) {
  std::fill(shift_.begin(), shift_.end(), 0.0);
  std::fill(constrained_.begin(), constrained_.end(), false);
  for (int level = 0; level < task_.levels && !search_.spent(); ++level) {
    set_weights(level, ratio_);
    for (int i = 0; i < SHIFTS; ++i) {
      search_.refine(scaled_.data(), shift_.data(), EXACT * std::pow(ratio_, 2 * level));
      if (search_.spent() || !shift()) break;
    }
    if (level == 0 && !was_unreached && !within(0)) search_.search(scaled_.data());
    constrained_[level] = within(level);
  }
  const bool spent = search_.spent();
  if (!spent) restore();
  search_.review(targets_);
  if (spent) return Status::BUDGET;
  return search_.reached(best()) ? Status::REACHED : Status::NEAREST;
}

bool Levels::shift() {
  bool slack = false;
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    slack = slack || (constrained_[task_.goals[e].level] &&
                      !search_.within(&best().errors[PARTS * e], LEVEL_TOLERANCE));
  if (!slack) return false;
  for (const Goal& goal : task_.goals)
    if (constrained_[goal.level])
      for (int i = goal.row; i < goal.row + rows_of(goal); ++i) shift_[i] = best().residuals[i];
  return true;
}

void Levels::restore() {
  bool slack = false;
  set_weights(task_.levels - 1, ratio_);
  task_.rest_weight = 0;
  for (int level = 0; level < task_.levels; ++level) {
    slack = slack || (constrained_[level] && !within(level));
    if (!constrained_[level]) scale(level, 0);
  }
  if (slack) search_.refine(scaled_.data(), nullptr, 0);
}

Status Levels::diagnose() {
  const bool hard = within(0);
  if (!hard && rest_weight_ > 0) {
    set_weights(0, 1);
    task_.rest_weight = 0;
    if (search_.reaches(scaled_.data())) return Status::SOFTENED;
  }
  if (requested_count() < 2) return Status::NEAREST;
  for (const std::size_t e : missed_goals()) {
    isolate_goal(e);
    if (!search_.reaches(scaled_.data())) return Status::NEAREST;
  }
  return hard ? Status::SOFTENED : Status::CONFLICT;
}

int Levels::requested_count() const {
  int count = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e) {
    bool any = false;
    for (int part = 0; part < PARTS; ++part)
      any = any || weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, part) > 0;
    count += any;
  }
  return count;
}

std::vector<std::size_t> Levels::missed_goals() const {
  std::vector<std::size_t> missed;
  const std::vector<double>& errors = best().errors;
  const auto most = [&](std::size_t e) {
    return *std::max_element(&errors[PARTS * e], &errors[PARTS * e] + PARTS);
  };
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    if (!search_.within(&errors[PARTS * e])) missed.push_back(e);
  std::sort(missed.begin(), missed.end(),
            [&](std::size_t a, std::size_t b) { return most(a) > most(b); });
  return missed;
}

}  // namespace animtool::ik
