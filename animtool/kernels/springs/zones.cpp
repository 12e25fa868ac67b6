// Rigid impact zones.
#include "springs/zones.h"

#include <algorithm>
#include <utility>

#include "springs/rigid_motion.h"

namespace animtool {

using collide::store;
using collide::Vec;
using shapes::row_of;

namespace {

// Weight of a pinned particle, over the mass of all free ones.
constexpr double PINNED = 1e3;

}  // namespace

void ImpactZones::clear() {
  for (const std::int32_t n : members_) parents_[static_cast<std::size_t>(n)] = -1;
  members_.clear();
}

std::int32_t ImpactZones::first_of(std::int32_t n) {
  std::int32_t& parent = parents_[static_cast<std::size_t>(n)];
  if (parent < 0) {
    parent = n;
    members_.push_back(n);
  }
  while (parents_[static_cast<std::size_t>(n)] != n) n = parents_[static_cast<std::size_t>(n)];
  return n;
}

void ImpactZones::join(const std::vector<LayerHit>& passed) {
  parents_.resize(inverse_masses_.size(), -1);
  for (const LayerHit& hit : passed) {
    const std::int32_t first = first_of(hit.who[0]);
    for (const std::int32_t n : hit.who) parents_[static_cast<std::size_t>(first_of(n))] = first;
  }
}

void ImpactZones::move(const std::vector<double>& from, std::vector<double>& before,
                       std::vector<double>& x) {
  std::vector<std::pair<std::int32_t, std::int32_t>> each;
  for (const std::int32_t n : members_) each.push_back({first_of(n), n});
  std::sort(each.begin(), each.end());
  std::vector<std::int32_t> group_rows;
  for (std::size_t i = 0; i < each.size(); ++i) {
    group_rows.push_back(each[i].second);
    if (i + 1 < each.size() && each[i + 1].first == each[i].first) continue;
    move_one(group_rows.data(), group_rows.size(), from, before, x);
    group_rows.clear();
  }
}

void ImpactZones::move_one(const std::int32_t* members, std::size_t count,
                           const std::vector<double>& from, std::vector<double>& before,
                           std::vector<double>& x) const {
  std::vector<double> masses(count);
  double full = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const double inverse = inverse_masses_[static_cast<std::size_t>(members[i])];
    full += masses[i] = inverse > 0 ? 1 / inverse : 0;
  }
  const double pinned = full > 0 ? PINNED * full : 1;
  for (double& mass : masses)
    if (mass == 0) mass = pinned;
  const RigidMotion shift(
      count, [&](std::size_t i) { return row_of(from.data(), members[i]); },
      [&](std::size_t i) { return row_of(x.data(), members[i]); },
      [&](std::size_t i) { return masses[i]; });
  for (std::size_t i = 0; i < count; ++i) {
    const auto n = static_cast<std::size_t>(members[i]);
    if (inverse_masses_[n] == 0) continue;
    const Vec begun = row_of(from.data(), members[i]);
    store(shift(begun), &x[ROW * n]);
    store(begun, &before[ROW * n]);
  }
}

}  // namespace animtool
