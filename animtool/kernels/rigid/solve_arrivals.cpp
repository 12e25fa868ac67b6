// Times of impact of bodies that will bounce: a substep is stopped there.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Later arrivals than this many substeps are not stopped for; earlier ones than this fraction of a
// substep count as contact.
constexpr double MAX_ARRIVAL_SUBSTEPS = 2, CONTACT_ARRIVAL_FRACTION = 1.0 / 64;
// Largest number of impact stops of an island in a substep; smaller for many patches. Largest
// number of impact rounds and root iterations at a stop.
constexpr std::size_t MAX_IMPACT_STOPS = 32, MAX_PATCH_IMPACT_STOPS = 256;
constexpr int MAX_IMPACT_ROUNDS = 4, MAX_ROOT_STEPS = 16;

}  // namespace

double Solver::time_to_impact(const Island& island, double remaining, double begin_fraction,
                              double end_fraction) {
  const double contact_time = substep_ * CONTACT_ARRIVAL_FRACTION;
  for (int round = 0; round < MAX_IMPACT_ROUNDS; ++round) {
    const double fraction =
        begin_fraction + (end_fraction - begin_fraction) * (1 - remaining / substep_);
    const double time = mark_bounces(remaining, fraction);
    if (time > contact_time || !(time < remaining)) return time;
    for (const std::size_t i : island.bodies) is_pushed_[i] = 0;
    ImpactSolver impacts(world_, patches_, points_, island.joints, rows_, speeds_,
                         settings_.tolerance, contact_time);
    impacts.run([&](const Patch& patch) { return rest_speed(patch); }, is_pushed_);
    for (const std::size_t i : island.bodies) store_velocity(i);
  }
  return remaining;
}

double Solver::mark_bounces(double remaining, double fraction) {
  double first_arrival = remaining;
  for (Patch& patch : patches_) {
    if (!(patch.restitution > 0)) continue;
    const double acceleration = normal_acceleration(patch, relative_acceleration(patch)),
                 min_speed = rest_speed(patch);
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      const double approach_speed = -separation_speed(patch, p), gap = std::max(p.current_gap, 0.0);
      // At the speed when the gap closes.
      const double arrival_speed = std::sqrt(
          std::max(approach_speed * std::fabs(approach_speed) + 2 * acceleration * gap, 0.0));
      p.will_bounce = arrival_speed > min_speed &&
                      2 * gap < MAX_ARRIVAL_SUBSTEPS * remaining * (approach_speed + arrival_speed);
      if (!p.will_bounce) continue;
      p.force = p.friction_forces[0] = p.friction_forces[1] = 0;
      first_arrival = std::min(first_arrival, time_of_arrival(patch, p, fraction, first_arrival));
    }
  }
  return first_arrival;
}

double Solver::time_of_arrival(const Patch& patch, const Point& p, double fraction,
                               double limit) const {
  double low = 0, high = limit, low_gap = p.current_gap,
         high_gap = gap_at(patch, p, fraction, limit);
  if (low_gap <= 0) return 0;
  if (high_gap > 0) return limit;
  const double tolerance = TOUCH_DISTANCE * world_.bodies[patch.a].bounding_radius / 8;
  for (int i = 0; i < MAX_ROOT_STEPS && high - low > substep_ * CONTACT_ARRIVAL_FRACTION / 4; ++i) {
    const double time = low + (high - low) * low_gap / (low_gap - high_gap);
    const double gap = gap_at(patch, p, fraction, time);
    if (std::fabs(gap) < tolerance) return time;
    if (gap > 0) {
      low = time, low_gap = gap, high_gap /= 2;
    } else {
      high = time, high_gap = gap, low_gap /= 2;
    }
  }
  return high;
}

double Solver::gap_at(const Patch& patch, const Point& p, double fraction, double time) const {
  const auto point_at = [&](std::size_t i, Vec local) {
    const State& s = states_[i];
    const Vec force_displacement = forces_[i] * (world_.bodies[i].inverse_mass * time * time / 2);
    const Vec arm = rotate(quaternion_from_vector(speeds_[i].w * time), poses_[i].rotate(local));
    return s.position + s.velocity * time + force_displacement + arm;
  };
  const Vec point_a = point_at(patch.a, p.local_a);
  const Vec point_b =
      patch.b < body_count_
          ? point_at(patch.b, p.local_b)
          : patch.contact->motion->pose_at(fraction + time / step_).to_world(p.local_b);
  return p.gap + dot(patch.normal, point_b - point_a) - patch.radius_sum;
}

double Solver::rest_speed(std::size_t a, std::size_t b, double restitution) const {
  double acceleration = length(forces_[a]) * world_.bodies[a].inverse_mass;
  if (b < body_count_)
    acceleration = std::max(acceleration, length(forces_[b]) * world_.bodies[b].inverse_mass);
  return acceleration * substep_ / (restitution > 0 ? restitution : 1);
}

Vec Solver::relative_acceleration(const Patch& patch) const {
  Vec acceleration = forces_[patch.a] * -world_.bodies[patch.a].inverse_mass;
  if (patch.b < body_count_)
    acceleration = acceleration + forces_[patch.b] * world_.bodies[patch.b].inverse_mass;
  return acceleration;
}

}  // namespace animtool::rigid
