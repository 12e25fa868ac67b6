// Self-contact of spring surfaces.
//
// M. Müller et al., Position Based Dynamics, 2007, 3.5 and 4.4 (particles against triangles,
// each on the side that it was); R. Bridson et al., Robust Treatment of Collisions, Contact
// and Friction for Cloth Animation, 2002, 6 and 7 (edges, thickness and friction).
#pragma once

#include <cstdint>
#include <optional>
#include <tuple>
#include <vector>

#include "springs/drift.h"
#include "springs/layer_contacts.h"
#include "springs/zones.h"

namespace animtool {

// Largest numbers of intersecting particles and of intersecting edge pairs; and the step rate at
// which all contacts would be within the tested distance, 0 if they were.
using IntersectionCounts = std::tuple<std::int64_t, std::int64_t, double>;

// Resolves self-contacts of a surface over the steps of a run: particles with triangles, then edges
// with edges if their interiors are closest.
class SelfContacts {
  // Iterations that separate tunnelling pairs in a step; and of all iterations, with rigid zones.
  static constexpr int SEPARATION_ITERATIONS = 6, MAX_ITERATIONS = 40;
  // Gap to which pairs in rigid zones are separated [contact distance].
  static constexpr double ZONE_GAP_FRACTION = 0.02;

 public:
  SelfContacts(const SpringLayers& layers, const SpringNetwork& network);
  // Without layers nothing is done. `initial_intersections` are intersections to resume with (C,
  // 3), as `intersections` returns them. With `resolves_intersections`, they are resolved and
  // tunnelling is prevented.
  SelfContacts(const SpringLayers* layers, const SpringNetwork& network,
               const In<std::int64_t, 2>& initial_intersections,
               bool resolves_intersections = false);

  // Begins an interval of time, or repeats the current one.
  void begin_interval(std::int64_t interval, const std::vector<double>& x);
  // Separates elements at the end of a step. If they only return to the contact distance, the
  // previous positions move too, so that no velocity is added.
  void separate(double h, std::vector<double>& before, std::vector<double>& x);
  // Moves pairs that tunnel through each other in the step: separates them, calling
  // `resolve_contacts` after each iteration, and as a last resort moves them rigidly. Only marked
  // particles may have moved since the last call; marks the particles that moved. Does nothing
  // unless intersections are resolved.
  template <class ResolveContacts>
  void prevent_tunnelling(double h, const std::vector<double>& from, std::vector<double>& before,
                          std::vector<double>& x, std::vector<std::uint8_t>& is_moved,
                          ResolveContacts resolve_contacts);
  // Records pairs that changed sides in the step, unless tunnelling is prevented.
  void record_intersections(const std::vector<double>& before, const std::vector<double>& x);

  // The remaining intersections (C, 3): particle, triangle and side; for edges, numbered after the
  // particles: edge, edge and side.
  Out<std::int64_t, 2> intersections() const;
  // Number of intersections now, and at the start of the interval.
  std::size_t intersection_count() const {
    return corner_contacts_.intersections.size() + edge_contacts_.intersections.size();
  }
  std::size_t initial_intersection_count() const {
    return initial_corner_intersections_.size() + initial_edge_intersections_.size();
  }
  // Updates the largest numbers of intersections at the end of an interval.
  void update_max_counts();
  IntersectionCounts max_counts() const {
    return {max_corner_intersections_, max_edge_intersections_, required_step_rate_};
  }

 private:
  // A list of pairs: positions when it was built, the distance up to which pairs are in it, and the
  // largest relative displacement since then.
  struct PairList {
    std::vector<double> positions;
    double distance = -1, drift = 0;

    bool covers(double required_distance) const { return required_distance + drift <= distance; }
    void reset(const std::vector<double>& x, double distance0) {
      positions = x, distance = distance0, drift = 0;
    }
  };

  // Checks and reads intersections to resume with.
  void read_intersections(const In<std::int64_t, 2>& initial_intersections);
  // Finds marked pairs that tunnel through each other in the step, and marks only their particles;
  // returns whether there are any.
  bool find_tunnelling(double h, const std::vector<double>& from, const std::vector<double>& x,
                       std::vector<std::uint8_t>& is_moved);
  void mark_zones(std::vector<std::uint8_t>& is_moved) const {
    for (const std::int32_t n : zones_->members()) is_moved[static_cast<std::size_t>(n)] = 1;
  }
  // Records tunnelling pairs as intersections.
  void record_tunnelling();
  // Separates pairs to a fraction of their contact distance.
  void separate_pairs(double h, const std::vector<LayerHit>& corners,
                      const std::vector<LayerHit>& edges, double distance_fraction,
                      std::vector<double>& before, std::vector<double>& x) const;
  // Measures the relative displacement of nearby elements in a step; `rebuild_cells` also rebuilds
  // the cells.
  void measure_displacements(double h, const std::vector<double>& before,
                             const std::vector<double>& x);
  void rebuild_cells(double h, const std::vector<double>& before, const std::vector<double>& x);
  // Whether all pairs that may become near in the step were in adjacent cells.
  bool are_cells_sufficient() const;
  // Rebuilds the pair lists that do not cover the step.
  void update_lists(double h, const std::vector<double>& before, const std::vector<double>& x);

  const SpringLayers* layers_;
  const SpringNetwork& network_;
  LayerContacts<TrianglesAndCorners> corner_contacts_;
  LayerContacts<EdgesAndEdges> edge_contacts_;
  std::optional<IntersectionResolver> resolver_;
  std::optional<ImpactZones> zones_;
  std::vector<LayerHit> tunnelling_corners_, tunnelling_edges_, zone_corners_, zone_edges_;
  std::vector<double> before_gaps_, x_before_gaps_;  // positions before gaps were widened
  std::vector<Intersection> initial_corner_intersections_, initial_edge_intersections_;
  std::int64_t interval_ = -1, max_corner_intersections_ = 0, max_edge_intersections_ = 0;

  PairList pair_list_, near_list_;
  RelativeMotion relative_motion_;
  std::vector<double>
      displacements_;        // since pairs were listed, relative to their common rigid motion
  double longest_edge_ = 0;  // longest edge when cells were built
  // Relative displacement of nearby elements in a step, and the tested part of it; the distance up
  // to which pairs are needed; and the step rate that would be needed.
  double travel_ = 0, tested_travel_ = 0, required_distance_ = 0, required_step_rate_ = 0;
  double total_drift_ =
      0;  // largest relative displacement of any two elements since pairs were listed
};

template <class ResolveContacts>
void SelfContacts::prevent_tunnelling(double h, const std::vector<double>& from,
                                      std::vector<double>& before, std::vector<double>& x,
                                      std::vector<std::uint8_t>& is_moved,
                                      ResolveContacts resolve_contacts) {
  if (!layers_ || !resolver_ || pair_list_.distance < 0) return;
  corner_contacts_.drop_resolved(*layers_, x);
  edge_contacts_.drop_resolved(*layers_, x);
  int iteration = 0;
  for (; find_tunnelling(h, from, x, is_moved); ++iteration) {
    if (iteration == MAX_ITERATIONS) return record_tunnelling();
    if (iteration < SEPARATION_ITERATIONS) {
      separate_pairs(h, tunnelling_corners_, tunnelling_edges_, 1, before, x);
      resolve_contacts();
      continue;
    }
    if (iteration == SEPARATION_ITERATIONS) {
      zones_->clear();
      zone_corners_.clear();
      zone_edges_.clear();
    }
    zones_->add_contacts(tunnelling_corners_);
    zones_->add_contacts(tunnelling_edges_);
    zones_->move_rigidly(from, before, x);
    zone_corners_.insert(zone_corners_.end(), tunnelling_corners_.begin(),
                         tunnelling_corners_.end());
    zone_edges_.insert(zone_edges_.end(), tunnelling_edges_.begin(), tunnelling_edges_.end());
    mark_zones(is_moved);
  }
  if (iteration <= SEPARATION_ITERATIONS) return;
  // Gaps would shrink over the steps until the motion of pinned particles, which is not rigid,
  // closes them.
  before_gaps_ = before, x_before_gaps_ = x;
  separate_pairs(h, zone_corners_, zone_edges_, ZONE_GAP_FRACTION, before, x);
  mark_zones(is_moved);
  if (find_tunnelling(h, from, x, is_moved)) before = before_gaps_, x = x_before_gaps_;
}

}  // namespace animtool
