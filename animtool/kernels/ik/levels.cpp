// The search with restarts, and prioritised goals.
#include "ik/levels.h"

namespace animtool::ik {

Status Search::run(const double* start, const double* targets, const double* rest, bool next) {
  short_ = next && outcome_.status == Status::NEAREST;
  // Frames that continue a search start elsewhere each time.
  if (!short_) random_ = Random(settings_.seed);
  if (!open(start, targets, rest)) return outcome_.status = Status::BROKEN;
  outcome_.status = look();
  last_cost_ = best_.cost;
  last_.q = best_.q;
  return outcome_.status;
}

void Search::refine(const double* targets, const double* shift, double least_gain) {
  aim(targets, shift);
  least_gain_ = std::max(least_gain, ROUNDED);
  begin(best_);
  descend(WARM, true);
  std::swap(now_, best_);
}

void Search::search(const double* targets) {
  aim(targets, nullptr);
  evaluate(best_);
  State kept = best_;
  best_.q = first_.q;
  evaluate(best_);
  short_ = false;
  look();
  if (!(best_.cost < kept.cost * BETTER)) std::swap(best_, kept);
}

Status Search::look() {
  floor_ = nearest_cost(task_, targets_, best_.frames);
  const bool mixed = task_.rest_weight > 0 || task_.levels > 1;
  least_gain_ = task_.levels > 1 ? ROUGH : mixed ? FINE : ROUNDED;
  const bool sure =
      floor_ > 0 || mixed || task_.chain.dofs >= REDUNDANT * rows_asked(task_, targets_);
  first_.q = best_.q;
  begin(best_);
  const End end = descend(settings_.damping, sure || short_);
  if (keep()) return Status::REACHED;
  if (short_ && settings_.separate_starts && go_on(sure)) return Status::REACHED;
  if (same(end)) {
    const double before = best_.cost;
    const int restarts = task_.levels > 1 ? 0 : std::min(RESTARTS_NEXT, settings_.restarts);
    for (int i = 0; i < restarts && !spent() && !settled(); ++i) {
      scatter(i % 2 ? best_ : first_);
      descend(COLD, sure);
      if (now_.cost > before * JUMP && !reached(now_)) continue;
      if (keep()) return Status::REACHED;
    }
    if (best_.cost == before) return Status::NEAREST;
  }
  const double exact = least_gain_;
  const bool reached_it = elsewhere(end == End::STUCK, sure);
  least_gain_ = exact;
  return reached_it && !mixed ? Status::REACHED : polish();
}

bool Search::elsewhere(bool stalled, bool sure) {
  const double exact = least_gain_;
  int agreeing = 0;
  const int enough = stepper_.abundant() ? FEW : AGREEING;
  for (int i = 0; i < settings_.restarts && !spent() && !settled(); ++i) {
    restart(i, stalled);
    least_gain_ = i == POLISHED ? exact : std::max(exact, COMPARED);
    descend(COLD, sure || i == POLISHED);
    const double before = best_.cost;
    if (now_.cost < before * BETTER)
      agreeing = 0;
    else if (now_.cost < before * (1 + 1e-2))
      ++agreeing;
    if (keep()) return true;
    if (agreeing >= enough) break;
  }
  return false;
}

void Search::restart(int i, bool stalled) {
  if (i == 0 && stalled) {
    begin(best_);
    shake();
  } else if (i == POLISHED) {
    begin(best_);
  } else if (i == 1) {
    straighten();
  } else {
    scatter(i % 2 ? best_ : first_);
  }
}

Status Search::polish() {
  if (spent()) return Status::BUDGET;
  begin(best_);
  const End end = descend(COLD, true);
  if (keep()) return Status::REACHED;
  return end == End::BUDGET ? Status::BUDGET : Status::NEAREST;
}

void Search::straighten() {
  for (const Node& node : task_.chain.nodes) {
    if (node.program >= 0) continue;
    double* values = &now_.q[node.coordinate];
    std::fill(values, values + (node.kind == Kind::BALL ? 4 : 1), 0.0);
    if (node.kind == Kind::BALL) values[3] = 1;
  }
  shake();
}

void Search::scatter(const State& home) {
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
  weigh(last, SOUGHT);
  search_.allow(last > 0 ? SEARCHED : 1);
  Status status = search_.run(start, scaled_.data(), rest, next);
  search_.allow(1);
  if ((status == Status::NEAREST || status == Status::BUDGET) && last > 0) {
    const bool cut = status == Status::BUDGET;
    status = settle(next && short_);
    if (cut && status == Status::NEAREST) status = Status::BUDGET;
  }
  short_ = last > 0 && !within(0);
  if (status == Status::NEAREST) status = explain();
  Outcome outcome = search_.outcome();
  outcome.status = status;
  return outcome;
}

void Levels::weigh(int last, double ratio) {
  std::copy(targets_, targets_ + scaled_.size(), scaled_.begin());
  double fraction = 1;
  for (int level = 1; level < task_.levels; ++level) {
    fraction *= ratio;
    const double values = heaviest(level), hard = heaviest(0);
    scale(level, level > last ? 0 : fraction * (values > 0 && hard > 0 ? hard / values : 1));
  }
  task_.rest_weight = last == task_.levels - 1 ? rest_weight_ * fraction * fraction : 0;
}

double Levels::heaviest(int level) const {
  double most = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    if (task_.goals[e].level == level)
      for (int part = 0; part < PARTS; ++part)
        most = std::max(most, weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, part));
  return most;
}

Status Levels::settle(bool known) {
  std::fill(shift_.begin(), shift_.end(), 0.0);
  std::fill(constrained_.begin(), constrained_.end(), false);
  for (int level = 0; level < task_.levels && !search_.spent(); ++level) {
    weigh(level, ratio_);
    for (int i = 0; i < SHIFTS; ++i) {
      search_.refine(scaled_.data(), shift_.data(), EXACT * std::pow(ratio_, 2 * level));
      if (search_.spent() || !shift()) break;
    }
    if (level == 0 && !known && !within(0)) search_.search(scaled_.data());
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
                      !search_.within(&best().misses[PARTS * e], CONSTRAINED));
  if (!slack) return false;
  for (const Goal& goal : task_.goals)
    if (constrained_[goal.level])
      for (int i = goal.row; i < goal.row + rows_of(goal); ++i) shift_[i] = best().residuals[i];
  return true;
}

void Levels::restore() {
  bool slack = false;
  weigh(task_.levels - 1, ratio_);
  task_.rest_weight = 0;
  for (int level = 0; level < task_.levels; ++level) {
    slack = slack || (constrained_[level] && !within(level));
    if (!constrained_[level]) scale(level, 0);
  }
  if (slack) search_.refine(scaled_.data(), nullptr, 0);
}

Status Levels::explain() {
  const bool hard = within(0);
  if (!hard && rest_weight_ > 0) {
    weigh(0, 1);
    task_.rest_weight = 0;
    if (search_.reaches(scaled_.data())) return Status::YIELDED;
  }
  if (asked() < 2) return Status::NEAREST;
  for (const std::size_t e : missed()) {
    single(e);
    if (!search_.reaches(scaled_.data())) return Status::NEAREST;
  }
  return hard ? Status::YIELDED : Status::CONFLICT;
}

int Levels::asked() const {
  int count = 0;
  for (std::size_t e = 0; e < task_.goals.size(); ++e) {
    bool any = false;
    for (int part = 0; part < PARTS; ++part)
      any = any || weight_of(task_.goals[e], targets_ + TARGET_WIDTH * e, part) > 0;
    count += any;
  }
  return count;
}

std::vector<std::size_t> Levels::missed() const {
  std::vector<std::size_t> reached_it;
  const std::vector<double>& misses = best().misses;
  const auto most = [&](std::size_t e) {
    return *std::max_element(&misses[PARTS * e], &misses[PARTS * e] + PARTS);
  };
  for (std::size_t e = 0; e < task_.goals.size(); ++e)
    if (!search_.within(&misses[PARTS * e])) reached_it.push_back(e);
  std::sort(reached_it.begin(), reached_it.end(),
            [&](std::size_t a, std::size_t b) { return most(a) > most(b); });
  return reached_it;
}

}  // namespace animtool::ik
