// Self-contact of spring surfaces.
#include "springs/self.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/checks.h"
#include "springs/steps.h"

namespace animtool {

namespace {

using collide::load;
using collide::Vec;

// Largest relative displacement in a step that is tested for crossings [thickness].
constexpr double MAX_TRAVEL = 4;
// Extra reach of the list of pairs [thickness].
constexpr double LIST_MARGIN = 4;
// Steps for which near pairs are picked from the list, and bounds of their reach [thickness].
constexpr double PICK_STEPS = 6, MIN_PICK = 0.03, MAX_PICK = 0.5;
// Speed of untangling [m/s].
constexpr double UNTANGLING_SPEED = 1;
// Width of the cells of nearby elements [longest edge, thickness].
constexpr double CELL_EDGES = 4, CELL = 8;

RigidMotion common_motion(const std::vector<double>& from, const std::vector<double>& to) {
  return {from.size() / ROW, [&](std::size_t n) { return load(&from[ROW * n]); },
          [&](std::size_t n) { return load(&to[ROW * n]); }, [](std::size_t) { return 1.0; }};
}

void check_layers(const SpringLayers& layers, const SpringNetwork& network) {
  if (layers.particles() == network.particles()) return;
  check::refuse("layers", check::text(layers.particles()) + " particles are not the " +
                              check::text(network.particles()) + " of the network");
}

}  // namespace

SelfContacts::SelfContacts(const SpringLayers& layers, const SpringNetwork& network)
    : layers_(&layers), network_(network) {}

SelfContacts::SelfContacts(const SpringLayers* layers, const SpringNetwork& network,
                           const In<std::int64_t, 2>& crossed, bool untangles)
    : layers_(layers), network_(network) {
  if (layers_) check_layers(*layers_, network);
  if (layers_ && untangles) {
    tangles_.emplace(*layers_, network.inverse_masses);
    zones_.emplace(network.inverse_masses);
  }
  check::shape("crossed", crossed, {check::ANY, 3});
  read(crossed);
}

void SelfContacts::read(const In<std::int64_t, 2>& crossed) {
  const auto within = [](std::int64_t n, std::size_t count) {
    return n >= 0 && n < static_cast<std::int64_t>(count);
  };
  for (std::size_t c = 0; c < crossed.size(); c += 3) {
    const std::int64_t* one = crossed.data() + c;
    const bool corner =
        layers_ && within(one[0], layers_->particles()) && within(one[1], layers_->triangles());
    const std::int64_t edge =
        layers_ && one[0] >= 0 ? one[0] - std::int64_t(layers_->particles()) : -1;
    const bool edges = layers_ && within(edge, layers_->edges()) && edge < one[1] &&
                       within(one[1], layers_->edges());
    if (!(edges || corner) || (one[2] != 1 && one[2] != -1))
      check::refuse("crossed", "row " + check::text(c / 3) + " is no passage of the layers");
    const auto second = static_cast<std::int32_t>(one[1]), side = static_cast<std::int32_t>(one[2]);
    if (edges)
      edges_.crossed.push_back({static_cast<std::int32_t>(edge), second, side});
    else
      corners_.crossed.push_back({second, static_cast<std::int32_t>(one[0]), side});
  }
  corners_.sort_crossed();
  edges_.sort_crossed();
}

void SelfContacts::begin_cell(std::int64_t cell, const std::vector<double>& x) {
  // A surface without piercing stays so.
  if (tangles_ && cell != cell_ && (cell_ < 0 || tangles_->any() || crossings() > 0))
    tangles_->find(x);
  if (cell == cell_) {
    corners_.crossed = start_corners_;
    edges_.crossed = start_edges_;
  } else {
    start_corners_ = corners_.crossed;
    start_edges_ = edges_.crossed;
  }
  cell_ = cell;
}

void SelfContacts::rebuild_cells(double h, const std::vector<double>& before,
                                 const std::vector<double>& x) {
  longest_ = 0;
  for (std::size_t e = 0; e < layers_->edges(); ++e)
    longest_ = std::max(longest_, length(shapes::Segment(layers_->ends(e), x.data()).shift()));
  const double back = layers_->speed * h;
  motion_.build(x, CELL_EDGES * longest_ + CELL * layers_->thickness + 2 * back);
  pair_list_.reach = near_list_.reach = -1;
  measure(h, before, x);
}

void SelfContacts::measure(double h, const std::vector<double>& before,
                           const std::vector<double>& x) {
  travel_ = motion_.between(before, x).near;
  max_travel_ = std::min(travel_, MAX_TRAVEL * layers_->thickness);
  need_ = max_travel_ + layers_->speed * h;
  total_drift_ = 0;
  if (pair_list_.reach < 0) return;
  const Drift drift = motion_.between(pair_list_.at, x, common_motion(pair_list_.at, x));
  pair_list_.drift = drift.near, total_drift_ = drift.all;
  near_list_.drift = motion_.between(near_list_.at, x, common_motion(near_list_.at, x)).near;
}

bool SelfContacts::cells_suffice() const {
  return total_drift_ + need_ + layers_->thickness + 2 * longest_ <= motion_.width();
}

void SelfContacts::list(double h, const std::vector<double>& before, const std::vector<double>& x) {
  if (cells_suffice() && near_list_.covers(need_)) return;
  const double d = layers_->thickness;
  if (!cells_suffice() || !pair_list_.covers(need_)) {
    rebuild_cells(h, before, x);
    pair_list_.begin(x, need_ + LIST_MARGIN * d);
    corners_.list(*layers_, x, pair_list_.reach);
    edges_.list(*layers_, x, pair_list_.reach);
  }
  const double reach = need_ + std::clamp(PICK_STEPS * travel_, MIN_PICK * d, MAX_PICK * d);
  near_list_.begin(x, std::min(reach, pair_list_.reach - pair_list_.drift));
  const RigidMotion shift = common_motion(pair_list_.at, x);
  displacements_.resize(x.size() / ROW);
  for (std::size_t n = 0; n < displacements_.size(); ++n)
    displacements_[n] = length(load(&x[ROW * n]) - shift(load(&pair_list_.at[ROW * n])));
  corners_.pick(*layers_, x, displacements_, near_list_.reach);
  edges_.pick(*layers_, x, displacements_, near_list_.reach);
}

void SelfContacts::separate(double h, std::vector<double>& before, std::vector<double>& x) {
  if (!layers_ || x.empty()) return;
  corners_.forget();
  edges_.forget();
  // After divergence, no side is known.
  if (!std::isfinite(std::accumulate(x.begin(), x.end(), 0.0))) return;
  if (pair_list_.reach < 0)
    rebuild_cells(h, before, x);
  else
    measure(h, before, x);
  list(h, before, x);
  const double most = MAX_TRAVEL * layers_->thickness, more = layers_->speed * h;
  if (travel_ > most) rate_needed_ = std::max(rate_needed_, travel_ / (most * h));
  const Tangles* tangles = tangles_ && tangles_->any() ? &*tangles_ : nullptr;
  if (tangles) tangles->part(UNTANGLING_SPEED * h, before, x);
  corners_.find(*layers_, before, x, max_travel_, more, tangles);
  edges_.find(*layers_, before, x, max_travel_, more, tangles);
  if (!corners_.any() && !edges_.any()) return;
  Separation separation(layers_->friction, layers_->speed * h, network_.inverse_masses, before, x);
  corners_.separate(*layers_, separation);
  edges_.separate(*layers_, separation);
  separation.end();
}

bool SelfContacts::find_passed(double h, const std::vector<double>& from,
                               const std::vector<double>& x, std::vector<std::uint8_t>& moved) {
  passed_corners_.clear();
  passed_edges_.clear();
  if (!std::isfinite(std::accumulate(x.begin(), x.end(), 0.0))) return false;
  measure(h, from, x);
  list(h, from, x);
  corners_.collect_passed(*layers_, from, x, moved, *tangles_, passed_corners_);
  edges_.collect_passed(*layers_, from, x, moved, *tangles_, passed_edges_);
  std::fill(moved.begin(), moved.end(), 0);
  for (const auto* passed : {&passed_corners_, &passed_edges_})
    for (const LayerHit& hit : *passed)
      for (const std::int32_t n : hit.who) moved[static_cast<std::size_t>(n)] = 1;
  return !passed_corners_.empty() || !passed_edges_.empty();
}

void SelfContacts::separate_passed(double h, std::vector<double>& before,
                                   std::vector<double>& x) const {
  Separation separation(layers_->friction, layers_->speed * h, network_.inverse_masses, before, x,
                        true);
  for (const LayerHit& hit : passed_corners_) separation.separate<TrianglesAndCorners::Shape>(hit);
  for (const LayerHit& hit : passed_edges_) separation.separate<EdgesAndEdges::Shape>(hit);
  separation.end();
}

void SelfContacts::record_passed() {
  for (const LayerHit& hit : passed_corners_)
    corners_.crossed.push_back({hit.first, hit.second, hit.side});
  for (const LayerHit& hit : passed_edges_)
    edges_.crossed.push_back({hit.first, hit.second, hit.side});
  corners_.sort_crossed();
  edges_.sort_crossed();
}

void SelfContacts::record_crossings(const std::vector<double>& before,
                                    const std::vector<double>& x) {
  if (!layers_ || tangles_) return;
  corners_.record_crossings(before, x);
  edges_.record_crossings(before, x);
}

Out<std::int64_t, 2> SelfContacts::ended() const {
  const std::size_t count = corners_.crossed.size() + edges_.crossed.size();
  Out<std::int64_t, 2> result(count, 3);
  std::int64_t* to = result.get();
  const auto add = [&](std::int64_t first, std::int64_t second, std::int64_t side) {
    for (const std::int64_t number : {first, second, side}) *to++ = number;
  };
  for (const Piercing& one : corners_.crossed) add(one.second, one.first, one.side);
  for (const Piercing& one : edges_.crossed)
    add(std::int64_t(layers_->particles()) + one.first, one.second, one.side);
  return result;
}

void SelfContacts::record_piercing() {
  std::vector<std::int32_t> who;
  for (const Piercing& one : corners_.crossed) who.push_back(one.second);
  std::sort(who.begin(), who.end());
  passed_ = std::max<std::int64_t>(passed_, std::unique(who.begin(), who.end()) - who.begin());
  cut_ = std::max(cut_, static_cast<std::int64_t>(edges_.crossed.size()));
}

Out<double, 3> part_springs(const SpringNetwork& network, const SpringLayers& layers,
                            In<double, 2> before, In<double, 3> after, double h) {
  const std::size_t count = network.particles();
  check_layers(layers, network);
  check::shape("before", before, {count, 3});
  check::shape("after", after, {2, count, 3});
  check::positive("h", h);
  std::vector<double> from(ROW * count), x(ROW * count);
  for (std::size_t n = 0; n < count; ++n) {
    std::copy_n(before.data() + 3 * n, 3, &from[ROW * n]);
    std::copy_n(after.data() + 3 * n, 3, &x[ROW * n]);
  }
  Out<double, 3> result(2, count, 3);
  SelfContacts(layers, network).separate(h, from, x);
  const double *locations = after.data(), *speeds = locations + 3 * count;
  for (std::size_t n = 0; n < count; ++n)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t row = ROW * n + k, at = 3 * n + k;
      // The velocity changes by the correction of the displacement.
      const double taken = (x[row] - locations[at]) - (from[row] - before.data()[at]);
      result.get()[at] = x[row];
      result.get()[3 * count + at] = speeds[at] + taken / h;
    }
  return result;
}

}  // namespace animtool
