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

// Piercing particles and pairs of edges, and the step rate that would detect contacts faster
// than the search range; 0 if there are none.
using SelfPiercing = std::tuple<std::int64_t, std::int64_t, double>;

// Self-contacts of a surface over the steps of a run: particles with triangles, then edges with
// edges if their interiors are closest.
class SelfContacts {
  // Iterations of separating piercing pairs in a step, and of all iterations.
  static constexpr int SEPARATION_ROUNDS = 6, MAX_ROUNDS = 40;

 public:
  SelfContacts(const SpringLayers& layers, const SpringNetwork& network);
  // Without layers nothing is done. `crossed` are piercings to resume with (C, 3), as `ended`
  // returns them. With `untangles`, tangles are resolved.
  SelfContacts(const SpringLayers* layers, const SpringNetwork& network,
               const In<std::int64_t, 2>& crossed, bool untangles = false);

  // Begins a cell of time, or repeats the current one.
  void begin_cell(std::int64_t cell, const std::vector<double>& x);
  // Separates elements at the end of a step; if they only return to the contact distance, the
  // previous positions move too, so that no velocity is added.
  void separate(double h, std::vector<double>& before, std::vector<double>& x);
  // Moves pairs that pass through each other in the step: separates them, calling `resolve` after
  // each iteration, and as a last resort moves them rigidly. Only marked particles may have moved
  // since the last call; moved particles are marked. Does nothing unless tangles are resolved.
  template <class Settle>
  void prevent_piercing(double h, const std::vector<double>& from, std::vector<double>& before,
                        std::vector<double>& x, std::vector<std::uint8_t>& moved, Settle resolve);
  // Records pairs that changed sides in the step, unless piercing is prevented.
  void record_crossings(const std::vector<double>& before, const std::vector<double>& x);

  // Particle, triangle and side of each remaining piercing (C, 3); for edges, numbered after the
  // particles: edge, edge and side.
  Out<std::int64_t, 2> ended() const;
  // Number of piercings now, and at the start of the cell.
  std::size_t crossings() const { return corners_.crossed.size() + edges_.crossed.size(); }
  std::size_t start_crossings() const { return start_corners_.size() + start_edges_.size(); }
  // Updates the largest counts of piercing at the end of a cell.
  void record_piercing();
  SelfPiercing piercing() const { return {passed_, cut_, rate_needed_}; }

 private:
  // Positions at the search for pairs, its reach, and the largest relative displacement since.
  struct Listing {
    std::vector<double> at;
    double reach = -1, drift = 0;

    bool covers(double need) const { return need + drift <= reach; }
    void begin(const std::vector<double>& x, double reach0) { at = x, reach = reach0, drift = 0; }
  };

  void read(const In<std::int64_t, 2>& crossed);
  // Finds marked pairs that pass through each other in the step, and marks only these; returns
  // whether there are any.
  bool find_passed(double h, const std::vector<double>& from, const std::vector<double>& x,
                   std::vector<std::uint8_t>& moved);
  void record_passed();
  void separate_passed(double h, std::vector<double>& before, std::vector<double>& x) const;
  // Measures the relative displacement of nearby elements in a step; the second rebuilds the cells.
  void measure(double h, const std::vector<double>& before, const std::vector<double>& x);
  void rebuild_cells(double h, const std::vector<double>& before, const std::vector<double>& x);
  // Whether all pairs that may come near in the step were in adjacent cells.
  bool cells_suffice() const;
  void list(double h, const std::vector<double>& before, const std::vector<double>& x);

  const SpringLayers* layers_;
  const SpringNetwork& network_;
  LayerContacts<TrianglesAndCorners> corners_;
  LayerContacts<EdgesAndEdges> edges_;
  std::optional<Tangles> tangles_;
  std::optional<ImpactZones> zones_;
  std::vector<LayerHit> passed_corners_, passed_edges_;
  std::vector<Piercing> start_corners_, start_edges_;
  std::int64_t cell_ = -1, passed_ = 0, cut_ = 0;

  Listing pair_list_, near_list_;
  RelativeMotion motion_;
  std::vector<double> displacements_;  // since pairs were listed, relative to a rigid motion of all
  double longest_ = 0;                 // longest edge when cells were built
  // Relative displacement of nearby elements in a step, and the tested part of it.
  double travel_ = 0, max_travel_ = 0, need_ = 0, rate_needed_ = 0;
  double total_drift_ = 0;  // largest relative displacement of all since
};

template <class Settle>
void SelfContacts::prevent_piercing(double h, const std::vector<double>& from,
                                    std::vector<double>& before, std::vector<double>& x,
                                    std::vector<std::uint8_t>& moved, Settle resolve) {
  if (!layers_ || !tangles_ || pair_list_.reach < 0) return;
  corners_.drop_resolved(*layers_, x);
  edges_.drop_resolved(*layers_, x);
  for (int round = 0; find_passed(h, from, x, moved); ++round) {
    if (round == MAX_ROUNDS) return record_passed();
    if (round < SEPARATION_ROUNDS) {
      separate_passed(h, before, x);
      resolve();
      continue;
    }
    if (round == SEPARATION_ROUNDS) zones_->clear();
    zones_->join(passed_corners_);
    zones_->join(passed_edges_);
    zones_->move(from, before, x);
    for (const std::int32_t n : zones_->members()) moved[static_cast<std::size_t>(n)] = 1;
  }
}

}  // namespace animtool
