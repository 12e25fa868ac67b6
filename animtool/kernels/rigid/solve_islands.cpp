// Sleeping, islands, and waking.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Friction at this many points supports a body; with fewer, or without support, it falls asleep
// below this fraction of the sleep speed.
constexpr int HELD = 3;
constexpr double LEANING = 0.25, CREEP = 0.01;

}  // namespace

void Solver::begin_groups() {
  groups_ = Groups(count_);
  for (const Joint& joint : world_.joints)
    if (joint.a >= 0) groups_.join(static_cast<std::size_t>(joint.a), joint.b);
}

bool Solver::wake() {
  if (!(settings_.drowsy > 0)) return false;
  begin_groups();
  const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
  for (const Kept& one : kept_)
    if (one.second < shapes)
      groups_.join(world_.shapes[static_cast<std::size_t>(one.first)].body,
           world_.shapes[static_cast<std::size_t>(one.second)].body);
  std::vector<char> called(count_, 0);
  const auto call = [&](std::size_t i) { called[groups_.first_of(i)] = 1; };
  for (std::size_t i = 0; i < count_; ++i)
    if (!sleeps(i)) called[groups_.first_of(i)] = 1;
  for (const Contact& c : contacts_) {
    const auto b = static_cast<std::size_t>(c.b);
    if (c.b < 0 ? sleeps(c.a) && c.motion->moves() : sleeps(c.a) != sleeps(b)) {
      call(c.a);
      if (c.b >= 0) call(b);
    }
  }
  for (std::size_t k = 0; k < world_.joints.size(); ++k) {
    const Joint& joint = world_.joints[k];
    if (joint.a < 0 ? sleeps(joint.b) && anchors_[k].moves()
                    : sleeps(joint.b) != sleeps(static_cast<std::size_t>(joint.a)))
      call(joint.b);
  }
  bool woken = false;
  for (std::size_t i = 0; i < count_; ++i)
    if (called[groups_.first_of(i)] && sleeps(i)) states_[i].idle = 0, woken = true;
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

void Solver::keep() {
  const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
  for (const Kept& one : kept_) {
    const bool both = sleeps(world_.shapes[static_cast<std::size_t>(one.first)].body) &&
                      (one.second >= shapes ||
                       sleeps(world_.shapes[static_cast<std::size_t>(one.second)].body));
    if (both) saved_.push_back(one);
  }
  std::stable_sort(saved_.begin(), saved_.end(), [](const Kept& a, const Kept& b) {
    return a.first != b.first ? a.first < b.first : a.second < b.second;
  });
  kept_ = std::move(saved_);
}

void Solver::rest() {
  for (const auto& island : islands_) {
    double speed = 0, least = std::numeric_limits<double>::infinity();
    bool held = !island.parting;
    for (const std::size_t i : island.bodies) {
      const State& s = states_[i];
      const double turning = length(spin_of(world_.bodies[i], s)) * world_.bodies[i].reach;
      const double own = length(s.velocity) + turning;
      speed = std::max(speed, own);
      const double share = held_at_[i] >= HELD ? 1 : held_at_[i] ? LEANING : CREEP;
      held &= own < settings_.drowsy * share && (held_at_[i] || supported(island));
    }
    for (const std::size_t i : island.bodies) {
      const bool slow = speed < settings_.drowsy && held;
      states_[i].idle = slow ? states_[i].idle + step_ : 0;
      least = std::min(least, states_[i].idle);
    }
    for (const std::size_t i : island.bodies) {
      states_[i].idle = std::min(states_[i].idle, std::max(least, settings_.rest / 2));
      if (least >= settings_.rest) states_[i].velocity = states_[i].momentum = {};
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
