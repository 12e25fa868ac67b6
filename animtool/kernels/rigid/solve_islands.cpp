// Sleeping, islands, and waking.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Friction at this many points supports a body; with fewer, or without support, it falls asleep
// below this fraction of the sleep speed.
constexpr int MIN_SUPPORTS = 3;
constexpr double PARTLY_SUPPORTED = 0.25, UNSUPPORTED = 0.01;

}  // namespace

void Solver::begin_groups() {
  groups_ = Groups(count_);
  for (const Joint& joint : world_.joints)
    if (joint.a >= 0) groups_.join(static_cast<std::size_t>(joint.a), joint.b);
}

bool Solver::wake() {
  if (!(settings_.sleep_speed > 0)) return false;
  begin_groups();
  const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
  for (const StoredContact& one : stored_contacts_)
    if (one.second < shapes)
      groups_.join(world_.shapes[static_cast<std::size_t>(one.first)].body,
                   world_.shapes[static_cast<std::size_t>(one.second)].body);
  std::vector<char> woken_groups(count_, 0);
  const auto wake_group = [&](std::size_t i) { woken_groups[groups_.first_of(i)] = 1; };
  for (std::size_t i = 0; i < count_; ++i)
    if (!sleeps(i)) woken_groups[groups_.first_of(i)] = 1;
  for (const Contact& c : contacts_) {
    const auto b = static_cast<std::size_t>(c.b);
    if (c.b < 0 ? sleeps(c.a) && c.motion->moves() : sleeps(c.a) != sleeps(b)) {
      wake_group(c.a);
      if (c.b >= 0) wake_group(b);
    }
  }
  for (std::size_t k = 0; k < world_.joints.size(); ++k) {
    const Joint& joint = world_.joints[k];
    if (joint.a < 0 ? sleeps(joint.b) && anchors_[k].moves()
                    : sleeps(joint.b) != sleeps(static_cast<std::size_t>(joint.a)))
      wake_group(joint.b);
  }
  bool woken = false;
  for (std::size_t i = 0; i < count_; ++i)
    if (woken_groups[groups_.first_of(i)] && sleeps(i)) states_[i].slow_time = 0, woken = true;
  return woken;
}

void Solver::make_islands() {
  begin_groups();
  for (const Contact& c : contacts_)
    if (c.b >= 0) groups_.join(c.a, static_cast<std::size_t>(c.b));
  std::vector<std::size_t> number(count_, count_);
  for (std::size_t i = 0; i < count_; ++i) {
    if (sleeps(i)) continue;
    std::size_t& n = number[groups_.first_of(i)];
    if (n == count_) n = islands_.size(), islands_.emplace_back();
    islands_[n].bodies.push_back(i);
    ++report_.awake;
  }
  for (std::size_t k = 0; k < contacts_.size(); ++k) {
    const std::size_t n = number[groups_.first_of(contacts_[k].a)];
    if (n < islands_.size()) islands_[n].contacts.push_back(k);
  }
  for (std::size_t k = 0; k < world_.joints.size(); ++k) {
    const std::size_t n = number[groups_.first_of(world_.joints[k].b)];
    if (n < islands_.size()) islands_[n].joints.push_back(k);
  }
}

void Solver::store_contacts() {
  const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
  for (const StoredContact& one : stored_contacts_) {
    const bool both =
        sleeps(world_.shapes[static_cast<std::size_t>(one.first)].body) &&
        (one.second >= shapes || sleeps(world_.shapes[static_cast<std::size_t>(one.second)].body));
    if (both) next_contacts_.push_back(one);
  }
  std::stable_sort(next_contacts_.begin(), next_contacts_.end(),
                   [](const StoredContact& a, const StoredContact& b) {
                     return a.first != b.first ? a.first < b.first : a.second < b.second;
                   });
  stored_contacts_ = std::move(next_contacts_);
}

void Solver::update_sleep() {
  for (const auto& island : islands_) {
    double speed = 0, least = std::numeric_limits<double>::infinity();
    bool supported_all = !island.separating;
    for (const std::size_t i : island.bodies) {
      const State& s = states_[i];
      const double turning = length(spin_of(world_.bodies[i], s)) * world_.bodies[i].reach;
      const double body_speed = length(s.velocity) + turning;
      speed = std::max(speed, body_speed);
      const double factor = support_counts_[i] >= MIN_SUPPORTS ? 1
                            : support_counts_[i]               ? PARTLY_SUPPORTED
                                                               : UNSUPPORTED;
      supported_all &=
          body_speed < settings_.sleep_speed * factor && (support_counts_[i] || supported(island));
    }
    for (const std::size_t i : island.bodies) {
      const bool slow = speed < settings_.sleep_speed && supported_all;
      states_[i].slow_time = slow ? states_[i].slow_time + step_ : 0;
      least = std::min(least, states_[i].slow_time);
    }
    for (const std::size_t i : island.bodies) {
      states_[i].slow_time =
          std::min(states_[i].slow_time, std::max(least, settings_.sleep_time / 2));
      if (least >= settings_.sleep_time) states_[i].velocity = states_[i].momentum = {};
    }
  }
}

bool Solver::supported(const Island& island) const {
  if (!island.contacts.empty() || !island.joints.empty()) return true;
  return std::all_of(island.bodies.begin(), island.bodies.end(), [&](std::size_t i) {
    const State& s = states_[i];
    const Vec sum = forces_[i] + torques_[i] + s.velocity + s.momentum;
    return dot(sum, sum) == 0;
  });
}

}  // namespace animtool::rigid
