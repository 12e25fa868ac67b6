// Times of impact of bodies that will bounce: a step is stopped there.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Arrivals within this many substeps are not stopped for; within this fraction of one they count as
// contact.
constexpr double MAX_ARRIVAL = 2, CONTACT_ARRIVAL = 1.0 / 64;
// Largest number of impact stops of an island in a substep, fewer for many pairs; and of rounds and
// searches at one.
constexpr std::size_t LEGS = 32, CROWD = 256;
constexpr int MAX_IMPACT_ROUNDS = 4, MAX_ROOT_STEPS = 16;

}  // namespace

double Solver::until_impact(const Island& island, double remaining, double begin, double end) {
  const double soon = substep_ * CONTACT_ARRIVAL;
  for (int again = 0; again < MAX_IMPACT_ROUNDS; ++again) {
    const double fraction = begin + (end - begin) * (1 - remaining / substep_);
    const double time = next_arrival(remaining, fraction);
    if (time > soon || !(time < remaining)) return time;
    for (const std::size_t i : island.bodies) pushed_[i] = 0;
    Impacts impacts(world_, patches_, points_, island.joints, rows_, speeds_, settings_.tolerance,
                    soon);
    impacts.run([&](const Patch& patch) { return rest_speed(patch); }, pushed_);
    for (const std::size_t i : island.bodies) store_velocity(i);
  }
  return remaining;
}

double Solver::next_arrival(double remaining, double fraction) {
  double first = remaining;
  for (Patch& patch : patches_) {
    if (!(patch.restitution > 0)) continue;
    const double pull = normal_acceleration(patch, relative_acceleration(patch)),
                 rest = rest_speed(patch);
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      const double into = -approach(patch, p), gap = std::max(p.current_gap, 0.0);
      // At the speed when the gap closes.
      const double arrival_speed =
          std::sqrt(std::max(into * std::fabs(into) + 2 * pull * gap, 0.0));
      p.will_bounce =
          arrival_speed > rest && 2 * gap < MAX_ARRIVAL * remaining * (into + arrival_speed);
      if (!p.will_bounce) continue;
      p.force = p.across[0] = p.across[1] = 0;
      first = std::min(first, arrival(patch, p, fraction, first));
    }
  }
  return first;
}

double Solver::arrival(const Patch& patch, const Point& p, double fraction, double within) const {
  double low = 0, high = within, at_low = p.current_gap,
         at_high = gap_at(patch, p, fraction, within);
  if (at_low <= 0) return 0;
  if (at_high > 0) return within;
  const double near = TOUCHING * world_.bodies[patch.a].reach / 8;
  for (int i = 0; i < MAX_ROOT_STEPS && high - low > substep_ * CONTACT_ARRIVAL / 4; ++i) {
    const double time = low + (high - low) * at_low / (at_low - at_high);
    const double gap = gap_at(patch, p, fraction, time);
    if (std::fabs(gap) < near) return time;
    if (gap > 0) {
      low = time, at_low = gap, at_high /= 2;
    } else {
      high = time, at_high = gap, at_low /= 2;
    }
  }
  return high;
}

double Solver::gap_at(const Patch& patch, const Point& p, double fraction, double time) const {
  const auto point_at = [&](std::size_t i, Vec local) {
    const State& s = states_[i];
    const Vec pulled = forces_[i] * (world_.bodies[i].inverse_mass * time * time / 2);
    const Vec arm = rotate(rotation_of(speeds_[i].w * time), poses_[i].rotated(local));
    return s.at + s.velocity * time + pulled + arm;
  };
  const Vec at_a = point_at(patch.a, p.on_a);
  const Vec far = patch.b < count_
                      ? point_at(patch.b, p.on_b)
                      : patch.contact->motion->at(fraction + time / step_).to_world(p.on_b);
  return p.gap + dot(patch.normal, far - at_a) - patch.skin;
}

double Solver::rest_speed(std::size_t a, std::size_t b, double restitution) const {
  double pull = length(forces_[a]) * world_.bodies[a].inverse_mass;
  if (b < count_) pull = std::max(pull, length(forces_[b]) * world_.bodies[b].inverse_mass);
  return pull * substep_ / (restitution > 0 ? restitution : 1);
}

Vec Solver::relative_acceleration(const Patch& patch) const {
  Vec pull = forces_[patch.a] * -world_.bodies[patch.a].inverse_mass;
  if (patch.b < count_) pull = pull + forces_[patch.b] * world_.bodies[patch.b].inverse_mass;
  return pull;
}

}  // namespace animtool::rigid
