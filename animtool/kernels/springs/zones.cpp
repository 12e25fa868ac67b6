// Rigid impact zones.
#include "springs/zones.h"

#include <algorithm>
#include <utility>

#include "springs/rigid_motion.h"

namespace animtool {

using collide::store;
using collide::Vec;
using shapes::position_of;

namespace {

// Weight of a pinned particle, over the mass of all free particles.
constexpr double PINNED_WEIGHT = 1e3;

}  // namespace

void ImpactZones::clear() {
  for (const std::int32_t n : members_) parents_[static_cast<std::size_t>(n)] = -1;
  members_.clear();
}

std::int32_t ImpactZones::find_root(std::int32_t n) {
  std::int32_t& parent = parents_[static_cast<std::size_t>(n)];
  if (parent < 0) {
    parent = n;
    members_.push_back(n);
  }
  while (parents_[static_cast<std::size_t>(n)] != n) n = parents_[static_cast<std::size_t>(n)];
  return n;
}

void ImpactZones::add_contacts(const std::vector<LayerHit>& contacts) {
  parents_.resize(inverse_masses_.size(), -1);
  for (const LayerHit& hit : contacts) {
    const std::int32_t first = find_root(hit.particles[0]);
    for (const std::int32_t n : hit.particles)
      parents_[static_cast<std::size_t>(find_root(n))] = first;
  }
}

void ImpactZones::move_rigidly(const std::vector<double>& from, std::vector<double>& before,
                               std::vector<double>& x) {
  std::vector<std::pair<std::int32_t, std::int32_t>> zone_members;
  for (const std::int32_t n : members_) zone_members.push_back({find_root(n), n});
  std::sort(zone_members.begin(), zone_members.end());
  std::vector<std::int32_t> zone;
  for (std::size_t i = 0; i < zone_members.size(); ++i) {
    zone.push_back(zone_members[i].second);
    if (i + 1 < zone_members.size() && zone_members[i + 1].first == zone_members[i].first) continue;
    move_zone(zone.data(), zone.size(), from, before, x);
    zone.clear();
  }
}

void ImpactZones::move_zone(const std::int32_t* members, std::size_t count,
                            const std::vector<double>& from, std::vector<double>& before,
                            std::vector<double>& x) const {
  std::vector<double> masses(count);
  double total_mass = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const double inverse_mass = inverse_masses_[static_cast<std::size_t>(members[i])];
    total_mass += masses[i] = inverse_mass > 0 ? 1 / inverse_mass : 0;
  }
  const double pinned_mass = total_mass > 0 ? PINNED_WEIGHT * total_mass : 1;
  for (double& mass : masses)
    if (mass == 0) mass = pinned_mass;
  const RigidMotion motion(
      count, [&](std::size_t i) { return position_of(from.data(), members[i]); },
      [&](std::size_t i) { return position_of(x.data(), members[i]); },
      [&](std::size_t i) { return masses[i]; });
  for (std::size_t i = 0; i < count; ++i) {
    const auto n = static_cast<std::size_t>(members[i]);
    if (inverse_masses_[n] == 0) continue;
    const Vec start_position = position_of(from.data(), members[i]);
    store(motion(start_position), &x[PARTICLE_STRIDE * n]);
    store(start_position, &before[PARTICLE_STRIDE * n]);
  }
}

}  // namespace animtool
