// Times of impact of bodies that will bounce: a step is stopped there.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Arrivals within this many substeps are not stopped for; within this fraction of one they count as
// contact.
constexpr double FLIES = 2, SOON = 1.0 / 64;
// Largest number of impact stops of an island in a substep, fewer for many pairs; and of rounds and
// searches at one.
constexpr std::size_t LEGS = 32, CROWD = 256;
constexpr int AGAIN = 4, ARRIVES = 16;

}  // namespace

double Solver::until_impact(const Island& island, double left, double begin, double end) {
  const double soon = small_ * SOON;
  for (int again = 0; again < AGAIN; ++again) {
    const double share = begin + (end - begin) * (1 - left / small_);
    const double time = next_arrival(left, share);
    if (time > soon || !(time < left)) return time;
    for (const std::size_t i : island.bodies) pushed_[i] = 0;
    Impacts impacts(world_, patches_, points_, island.joints, rows_, speeds_,
                    settings_.tolerance, soon);
    impacts.run([&](const Patch& patch) { return rest_of(patch); }, pushed_);
    for (const std::size_t i : island.bodies) settle(i);
  }
  return left;
}

double Solver::next_arrival(double left, double share) {
  double first = left;
  for (Patch& patch : patches_) {
    if (!(patch.restitution > 0)) continue;
    const double pull = pull_along(patch, relative_pull(patch)), rest = rest_of(patch);
    for (std::size_t k = patch.begin; k < patch.end; ++k) {
      Point& p = points_[k];
      const double into = -approach(patch, p), gap = std::max(p.now, 0.0);
      // At the speed when the gap closes.
      const double coming = std::sqrt(std::max(into * std::fabs(into) + 2 * pull * gap, 0.0));
      p.flies = coming > rest && 2 * gap < FLIES * left * (into + coming);
      if (!p.flies) continue;
      p.force = p.across[0] = p.across[1] = 0;
      first = std::min(first, arrival(patch, p, share, first));
    }
  }
  return first;
}

double Solver::arrival(const Patch& patch, const Point& p, double share, double within) const {
  double low = 0, high = within, at_low = p.now, at_high = gap_at(patch, p, share, within);
  if (at_low <= 0) return 0;
  if (at_high > 0) return within;
  const double near = TOUCHING * world_.bodies[patch.a].reach / 8;
  for (int i = 0; i < ARRIVES && high - low > small_ * SOON / 4; ++i) {
    const double time = low + (high - low) * at_low / (at_low - at_high);
    const double gap = gap_at(patch, p, share, time);
    if (std::fabs(gap) < near) return time;
    if (gap > 0) {
      low = time, at_low = gap, at_high /= 2;
    } else {
      high = time, at_high = gap, at_low /= 2;
    }
  }
  return high;
}

double Solver::gap_at(const Patch& patch, const Point& p, double share, double time) const {
  const auto place = [&](std::size_t i, Vec own) {
    const State& s = states_[i];
    const Vec pulled = forces_[i] * (world_.bodies[i].ease * time * time / 2);
    const Vec arm = rotate(turn_of(speeds_[i].w * time), turns_[i].rotated(own));
    return s.at + s.velocity * time + pulled + arm;
  };
  const Vec own = place(patch.a, p.own);
  const Vec far = patch.b < count_
                      ? place(patch.b, p.other)
                      : patch.contact->motion->at(share + time / step_).to_world(p.other);
  return p.gap + dot(patch.normal, far - own) - patch.skin;
}

double Solver::rest_of(std::size_t a, std::size_t b, double restitution) const {
  double pull = length(forces_[a]) * world_.bodies[a].ease;
  if (b < count_) pull = std::max(pull, length(forces_[b]) * world_.bodies[b].ease);
  return pull * small_ / (restitution > 0 ? restitution : 1);
}

Vec Solver::relative_pull(const Patch& patch) const {
  Vec pull = forces_[patch.a] * -world_.bodies[patch.a].ease;
  if (patch.b < count_) pull = pull + forces_[patch.b] * world_.bodies[patch.b].ease;
  return pull;
}

}  // namespace animtool::rigid
