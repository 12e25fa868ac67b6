// Sleeping, islands, and waking.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// A body with friction at this many points is supported. With fewer points, or without support, it
// falls asleep below a fraction of the sleep speed.
constexpr int MIN_SUPPORT_POINTS = 3;
constexpr double PARTIAL_SUPPORT_FACTOR = 0.25, NO_SUPPORT_FACTOR = 0.01;

}  // namespace

void Solver::reset_groups() {
  groups_ = Groups(body_count_);
  for (const Joint& joint : world_.joints)
    if (joint.a >= 0) groups_.merge(static_cast<std::size_t>(joint.a), joint.b);
}

bool Solver::wake_bodies() {
  if (!(settings_.sleep_speed > 0)) return false;
  reset_groups();
  const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
  for (const StoredContact& contact : stored_contacts_)
    if (contact.second_shape < shapes)
      groups_.merge(world_.shapes[static_cast<std::size_t>(contact.first_shape)].body,
                    world_.shapes[static_cast<std::size_t>(contact.second_shape)].body);
  std::vector<char> is_group_awake(body_count_, 0);
  const auto wake_group = [&](std::size_t i) { is_group_awake[groups_.find_root(i)] = 1; };
  for (std::size_t i = 0; i < body_count_; ++i)
    if (!is_asleep(i)) is_group_awake[groups_.find_root(i)] = 1;
  for (const Contact& c : contacts_) {
    const auto b = static_cast<std::size_t>(c.body_b);
    if (c.body_b < 0 ? is_asleep(c.body_a) && c.motion->is_moving()
                     : is_asleep(c.body_a) != is_asleep(b)) {
      wake_group(c.body_a);
      if (c.body_b >= 0) wake_group(b);
    }
  }
  for (std::size_t k = 0; k < world_.joints.size(); ++k) {
    const Joint& joint = world_.joints[k];
    if (joint.a < 0 ? is_asleep(joint.b) && anchors_[k].is_moving()
                    : is_asleep(joint.b) != is_asleep(static_cast<std::size_t>(joint.a)))
      wake_group(joint.b);
  }
  bool has_woken = false;
  for (std::size_t i = 0; i < body_count_; ++i)
    if (is_group_awake[groups_.find_root(i)] && is_asleep(i))
      states_[i].slow_time = 0, has_woken = true;
  return has_woken;
}

void Solver::build_islands() {
  reset_groups();
  for (const Contact& c : contacts_)
    if (c.body_b >= 0) groups_.merge(c.body_a, static_cast<std::size_t>(c.body_b));
  std::vector<std::size_t> island_of_group(body_count_, body_count_);
  for (std::size_t i = 0; i < body_count_; ++i) {
    if (is_asleep(i)) continue;
    std::size_t& island = island_of_group[groups_.find_root(i)];
    if (island == body_count_) island = islands_.size(), islands_.emplace_back();
    islands_[island].bodies.push_back(i);
    ++report_.awake_count;
  }
  for (std::size_t k = 0; k < contacts_.size(); ++k) {
    const std::size_t island = island_of_group[groups_.find_root(contacts_[k].body_a)];
    if (island < islands_.size()) islands_[island].contacts.push_back(k);
  }
  for (std::size_t k = 0; k < world_.joints.size(); ++k) {
    const std::size_t island = island_of_group[groups_.find_root(world_.joints[k].b)];
    if (island < islands_.size()) islands_[island].joints.push_back(k);
  }
}

void Solver::store_contacts() {
  const auto shapes = static_cast<std::int64_t>(world_.shapes.size());
  for (const StoredContact& contact : stored_contacts_) {
    const bool are_asleep =
        is_asleep(world_.shapes[static_cast<std::size_t>(contact.first_shape)].body) &&
        (contact.second_shape >= shapes ||
         is_asleep(world_.shapes[static_cast<std::size_t>(contact.second_shape)].body));
    if (are_asleep) next_contacts_.push_back(contact);
  }
  std::stable_sort(next_contacts_.begin(), next_contacts_.end(),
                   [](const StoredContact& a, const StoredContact& b) {
                     return a.first_shape != b.first_shape ? a.first_shape < b.first_shape
                                                           : a.second_shape < b.second_shape;
                   });
  stored_contacts_ = std::move(next_contacts_);
}

void Solver::update_sleep() {
  for (const auto& island : islands_) {
    double speed = 0, min_slow_time = std::numeric_limits<double>::infinity();
    bool is_slow_and_supported = !island.has_penetration;
    for (const std::size_t i : island.bodies) {
      const State& s = states_[i];
      const double rim_speed =
          length(angular_velocity_of(world_.bodies[i], s)) * world_.bodies[i].bounding_radius;
      const double body_speed = length(s.velocity) + rim_speed;
      speed = std::max(speed, body_speed);
      const double factor = support_counts_[i] >= MIN_SUPPORT_POINTS ? 1
                            : support_counts_[i]                     ? PARTIAL_SUPPORT_FACTOR
                                                                     : NO_SUPPORT_FACTOR;
      is_slow_and_supported &= body_speed < settings_.sleep_speed * factor &&
                               (support_counts_[i] || is_supported(island));
    }
    for (const std::size_t i : island.bodies) {
      const bool is_slow = speed < settings_.sleep_speed && is_slow_and_supported;
      states_[i].slow_time = is_slow ? states_[i].slow_time + step_ : 0;
      min_slow_time = std::min(min_slow_time, states_[i].slow_time);
    }
    for (const std::size_t i : island.bodies) {
      states_[i].slow_time =
          std::min(states_[i].slow_time, std::max(min_slow_time, settings_.sleep_time / 2));
      if (min_slow_time >= settings_.sleep_time) states_[i].velocity = states_[i].momentum = {};
    }
  }
}

bool Solver::is_supported(const Island& island) const {
  if (!island.contacts.empty() || !island.joints.empty()) return true;
  return std::all_of(island.bodies.begin(), island.bodies.end(), [&](std::size_t i) {
    const State& s = states_[i];
    const Vec activity = forces_[i] + torques_[i] + s.velocity + s.momentum;
    return dot(activity, activity) == 0;
  });
}

}  // namespace animtool::rigid
