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

// Largest relative displacement in a step for which tunnelling is tested [thickness].
constexpr double MAX_TESTED_TRAVEL = 4;
// Extra distance up to which pairs are listed, relative to the longest edge plus the thickness: a
// list of pairs takes time in proportion to the square of its distance over that sum, and is
// rebuilt when elements have moved by the margin. Times of flags and capes are lowest near this.
constexpr double PAIR_LIST_MARGIN = 0.3;
// Number of steps for which near pairs are picked from the list; bounds of their distance
// [thickness].
constexpr double NEAR_LIST_STEPS = 6, MIN_NEAR_MARGIN = 0.03, MAX_NEAR_MARGIN = 0.5;
// Speed of untangling [m/s].
constexpr double RESOLVING_SPEED = 1;
// Width of the cells of nearby elements: this many longest edges plus this many thicknesses.
constexpr double CELL_EDGE_FACTOR = 4, CELL_THICKNESS_FACTOR = 8;

// The rigid motion that fits the displacements of all particles.
RigidMotion fit_common_motion(const std::vector<double>& from, const std::vector<double>& to) {
  return {from.size() / PARTICLE_STRIDE,
          [&](std::size_t n) { return load(&from[PARTICLE_STRIDE * n]); },
          [&](std::size_t n) { return load(&to[PARTICLE_STRIDE * n]); },
          [](std::size_t) { return 1.0; }};
}

void check_layers(const SpringLayers& layers, const SpringNetwork& network) {
  if (layers.particle_count() == network.particle_count()) return;
  check::refuse("layers", check::text(layers.particle_count()) + " particles are not the " +
                              check::text(network.particle_count()) + " of the network");
}

}  // namespace

SelfContacts::SelfContacts(const SpringLayers& layers, const SpringNetwork& network)
    : layers_(&layers), network_(network) {}

SelfContacts::SelfContacts(const SpringLayers* layers, const SpringNetwork& network,
                           const In<std::int64_t, 2>& initial_intersections,
                           bool resolves_intersections)
    : layers_(layers), network_(network) {
  if (layers_) check_layers(*layers_, network);
  if (layers_ && resolves_intersections) {
    resolver_.emplace(*layers_, network.inverse_masses);
    zones_.emplace(network.inverse_masses);
  }
  check::shape("initial_intersections", initial_intersections, {check::ANY, 3});
  read_intersections(initial_intersections);
}

void SelfContacts::read_intersections(const In<std::int64_t, 2>& initial_intersections) {
  const auto is_index = [](std::int64_t n, std::size_t count) {
    return n >= 0 && n < static_cast<std::int64_t>(count);
  };
  for (std::size_t c = 0; c < initial_intersections.size(); c += 3) {
    const std::int64_t* row = initial_intersections.data() + c;
    const bool is_corner = layers_ && is_index(row[0], layers_->particle_count()) &&
                           is_index(row[1], layers_->triangle_count());
    const std::int64_t edge =
        layers_ && row[0] >= 0 ? row[0] - std::int64_t(layers_->particle_count()) : -1;
    const bool is_edge = layers_ && is_index(edge, layers_->edge_count()) && edge < row[1] &&
                         is_index(row[1], layers_->edge_count());
    if (!(is_edge || is_corner) || (row[2] != 1 && row[2] != -1))
      check::refuse("initial_intersections",
                    "row " + check::text(c / 3) + " is not an intersection of the surface");
    const auto second = static_cast<std::int32_t>(row[1]), side = static_cast<std::int32_t>(row[2]);
    if (is_edge)
      edge_contacts_.intersections.push_back({static_cast<std::int32_t>(edge), second, side});
    else
      corner_contacts_.intersections.push_back({second, static_cast<std::int32_t>(row[0]), side});
  }
  corner_contacts_.sort_intersections();
  edge_contacts_.sort_intersections();
}

void SelfContacts::begin_interval(std::int64_t interval, const std::vector<double>& x) {
  // A surface without intersections cannot begin to intersect itself.
  if (resolver_ && interval != interval_ &&
      (interval_ < 0 || resolver_->has_intersections() || intersection_count() > 0))
    resolver_->find(x);
  if (interval == interval_) {
    corner_contacts_.intersections = initial_corner_intersections_;
    edge_contacts_.intersections = initial_edge_intersections_;
  } else {
    initial_corner_intersections_ = corner_contacts_.intersections;
    initial_edge_intersections_ = edge_contacts_.intersections;
  }
  interval_ = interval;
}

void SelfContacts::rebuild_cells(double h, const std::vector<double>& before,
                                 const std::vector<double>& x) {
  longest_edge_ = 0;
  for (std::size_t e = 0; e < layers_->edge_count(); ++e)
    longest_edge_ =
        std::max(longest_edge_, length(shapes::Segment(layers_->ends(e), x.data()).vector()));
  const double return_distance = layers_->separation_speed * h;
  relative_motion_.build(x, CELL_EDGE_FACTOR * longest_edge_ +
                                CELL_THICKNESS_FACTOR * layers_->thickness + 2 * return_distance);
  pair_list_.distance = near_list_.distance = -1;
  measure_displacements(h, before, x);
}

void SelfContacts::measure_displacements(double h, const std::vector<double>& before,
                                         const std::vector<double>& x) {
  travel_ = relative_motion_.measure(before, x).nearby_bound;
  tested_travel_ = std::min(travel_, MAX_TESTED_TRAVEL * layers_->thickness);
  required_distance_ = tested_travel_ + layers_->separation_speed * h;
  total_drift_ = 0;
  if (pair_list_.distance < 0) return;
  const Drift drift =
      relative_motion_.measure(pair_list_.positions, x, fit_common_motion(pair_list_.positions, x));
  pair_list_.drift = drift.nearby_bound, total_drift_ = drift.overall_bound;
  near_list_.drift =
      relative_motion_.measure(near_list_.positions, x, fit_common_motion(near_list_.positions, x))
          .nearby_bound;
}

bool SelfContacts::are_cells_sufficient() const {
  return total_drift_ + required_distance_ + layers_->thickness + 2 * longest_edge_ <=
         relative_motion_.width();
}

void SelfContacts::update_lists(double h, const std::vector<double>& before,
                                const std::vector<double>& x) {
  if (are_cells_sufficient() && near_list_.covers(required_distance_)) return;
  const double thickness = layers_->thickness;
  if (!are_cells_sufficient() || !pair_list_.covers(required_distance_)) {
    rebuild_cells(h, before, x);
    pair_list_.reset(x, required_distance_ + PAIR_LIST_MARGIN * (longest_edge_ + thickness));
    corner_contacts_.list_pairs(*layers_, x, pair_list_.distance);
    edge_contacts_.list_pairs(*layers_, x, pair_list_.distance);
  }
  const double distance =
      required_distance_ + std::clamp(NEAR_LIST_STEPS * travel_, MIN_NEAR_MARGIN * thickness,
                                      MAX_NEAR_MARGIN * thickness);
  near_list_.reset(x, std::min(distance, pair_list_.distance - pair_list_.drift));
  const RigidMotion motion = fit_common_motion(pair_list_.positions, x);
  displacements_.resize(x.size() / PARTICLE_STRIDE);
  for (std::size_t n = 0; n < displacements_.size(); ++n)
    displacements_[n] = length(load(&x[PARTICLE_STRIDE * n]) -
                               motion(load(&pair_list_.positions[PARTICLE_STRIDE * n])));
  corner_contacts_.filter_near_pairs(*layers_, x, displacements_, near_list_.distance);
  edge_contacts_.filter_near_pairs(*layers_, x, displacements_, near_list_.distance);
}

void SelfContacts::separate(double h, std::vector<double>& before, std::vector<double>& x) {
  if (!layers_ || x.empty()) return;
  corner_contacts_.clear_contacts();
  edge_contacts_.clear_contacts();
  // After divergence, no side is known.
  if (!std::isfinite(std::accumulate(x.begin(), x.end(), 0.0))) return;
  if (pair_list_.distance < 0)
    rebuild_cells(h, before, x);
  else
    measure_displacements(h, before, x);
  update_lists(h, before, x);
  const double max_travel = MAX_TESTED_TRAVEL * layers_->thickness,
               return_distance = layers_->separation_speed * h;
  if (travel_ > max_travel)
    required_step_rate_ = std::max(required_step_rate_, travel_ / (max_travel * h));
  const IntersectionResolver* resolver =
      resolver_ && resolver_->has_intersections() ? &*resolver_ : nullptr;
  if (resolver) resolver->resolve(RESOLVING_SPEED * h, before, x);
  corner_contacts_.find_contacts(*layers_, before, x, tested_travel_, return_distance, resolver);
  edge_contacts_.find_contacts(*layers_, before, x, tested_travel_, return_distance, resolver);
  if (!corner_contacts_.has_hits() && !edge_contacts_.has_hits()) return;
  Separation separation(layers_->friction, layers_->separation_speed * h, network_.inverse_masses,
                        before, x);
  corner_contacts_.separate(*layers_, separation);
  edge_contacts_.separate(*layers_, separation);
  separation.finish();
}

bool SelfContacts::find_tunnelling(double h, const std::vector<double>& from,
                                   const std::vector<double>& x,
                                   std::vector<std::uint8_t>& is_moved) {
  tunnelling_corners_.clear();
  tunnelling_edges_.clear();
  if (!std::isfinite(std::accumulate(x.begin(), x.end(), 0.0))) return false;
  measure_displacements(h, from, x);
  update_lists(h, from, x);
  corner_contacts_.collect_tunnelling(*layers_, from, x, is_moved, *resolver_, tunnelling_corners_);
  edge_contacts_.collect_tunnelling(*layers_, from, x, is_moved, *resolver_, tunnelling_edges_);
  std::fill(is_moved.begin(), is_moved.end(), 0);
  for (const auto* contacts : {&tunnelling_corners_, &tunnelling_edges_})
    for (const LayerHit& hit : *contacts)
      for (const std::int32_t n : hit.particles) is_moved[static_cast<std::size_t>(n)] = 1;
  return !tunnelling_corners_.empty() || !tunnelling_edges_.empty();
}

void SelfContacts::separate_pairs(double h, const std::vector<LayerHit>& corners,
                                  const std::vector<LayerHit>& edges, double distance_fraction,
                                  std::vector<double>& before, std::vector<double>& x) const {
  Separation separation(layers_->friction, layers_->separation_speed * h, network_.inverse_masses,
                        before, x, true);
  const auto at_fraction = [&](LayerHit hit) {
    hit.distance *= distance_fraction;
    return hit;
  };
  for (const LayerHit& hit : corners)
    separation.separate<TrianglesAndCorners::Shape>(at_fraction(hit));
  for (const LayerHit& hit : edges) separation.separate<EdgesAndEdges::Shape>(at_fraction(hit));
  separation.finish();
}

void SelfContacts::record_tunnelling() {
  for (const LayerHit& hit : tunnelling_corners_)
    corner_contacts_.intersections.push_back({hit.first, hit.second, hit.side});
  for (const LayerHit& hit : tunnelling_edges_)
    edge_contacts_.intersections.push_back({hit.first, hit.second, hit.side});
  corner_contacts_.sort_intersections();
  edge_contacts_.sort_intersections();
}

void SelfContacts::record_intersections(const std::vector<double>& before,
                                        const std::vector<double>& x) {
  if (!layers_ || resolver_) return;
  corner_contacts_.record_intersections(before, x);
  edge_contacts_.record_intersections(before, x);
}

Out<std::int64_t, 2> SelfContacts::intersections() const {
  const std::size_t count =
      corner_contacts_.intersections.size() + edge_contacts_.intersections.size();
  Out<std::int64_t, 2> result(count, 3);
  std::int64_t* out = result.get();
  const auto add_row = [&](std::int64_t first, std::int64_t second, std::int64_t side) {
    for (const std::int64_t number : {first, second, side}) *out++ = number;
  };
  for (const Intersection& intersection : corner_contacts_.intersections)
    add_row(intersection.second, intersection.first, intersection.side);
  for (const Intersection& intersection : edge_contacts_.intersections)
    add_row(std::int64_t(layers_->particle_count()) + intersection.first, intersection.second,
            intersection.side);
  return result;
}

void SelfContacts::update_max_counts() {
  std::vector<std::int32_t> intersecting_particles;
  for (const Intersection& intersection : corner_contacts_.intersections)
    intersecting_particles.push_back(intersection.second);
  std::sort(intersecting_particles.begin(), intersecting_particles.end());
  max_corner_intersections_ = std::max<std::int64_t>(
      max_corner_intersections_,
      std::unique(intersecting_particles.begin(), intersecting_particles.end()) -
          intersecting_particles.begin());
  max_edge_intersections_ = std::max(
      max_edge_intersections_, static_cast<std::int64_t>(edge_contacts_.intersections.size()));
}

Out<double, 3> part_springs(const SpringNetwork& network, const SpringLayers& layers,
                            In<double, 2> before, In<double, 3> after, double h) {
  const std::size_t count = network.particle_count();
  check_layers(layers, network);
  check::shape("before", before, {count, 3});
  check::shape("after", after, {2, count, 3});
  check::positive("h", h);
  std::vector<double> from(PARTICLE_STRIDE * count), x(PARTICLE_STRIDE * count);
  for (std::size_t n = 0; n < count; ++n) {
    std::copy_n(before.data() + 3 * n, 3, &from[PARTICLE_STRIDE * n]);
    std::copy_n(after.data() + 3 * n, 3, &x[PARTICLE_STRIDE * n]);
  }
  Out<double, 3> result(2, count, 3);
  SelfContacts(layers, network).separate(h, from, x);
  const double *positions = after.data(), *velocities = positions + 3 * count;
  for (std::size_t n = 0; n < count; ++n)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t row = PARTICLE_STRIDE * n + k, index = 3 * n + k;
      // The velocity changes by the correction of the displacement.
      const double correction = (x[row] - positions[index]) - (from[row] - before.data()[index]);
      result.get()[index] = x[row];
      result.get()[3 * count + index] = velocities[index] + correction / h;
    }
  return result;
}

}  // namespace animtool
