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
using SelfThrough = std::tuple<std::int64_t, std::int64_t, double>;

// Self-contacts of a surface over the steps of a run: particles with triangles, then edges with
// edges if their interiors are closest.
class SelfContacts {
  // Rounds of resolving piercing in a step, and of all rounds.
  static constexpr int SEPARATION_ROUNDS = 6, MAX_ROUNDS = 40;

 public:
  SelfContacts(const SpringLayers& layers, const SpringNetwork& network);
  // Without layers nothing is done. Crossed: piercings to resume with (C, 3), as `ended` returns
  // them. With `frees`, tangles are resolved.
  SelfContacts(const SpringLayers* layers, const SpringNetwork& network,
               const In<std::int64_t, 2>& crossed, bool frees = false);

  // A cell of time begins; one that began before is crossed again.
  void begin_cell(std::int64_t cell, const std::vector<double>& x);
  // Separates parts at the end of a step; where they only return to the kept distance, the
  // previous positions move too, so that no velocity is added.
  void separate(double h, std::vector<double>& before, std::vector<double>& x);
  // Where a step from here leads parts through each other, they are moved until none is:
  // apart, with `settle` told after each round, and at last as one. Only particles that are
  // marked may have moved since that was so; those that are moved are marked. Does nothing
  // unless what is tangled comes free.
  template <class Settle>
  void prevent_piercing(double h, const std::vector<double>& from, std::vector<double>& before,
                  std::vector<double>& x, std::vector<std::uint8_t>& moved, Settle settle);
  // Notes who is on another side than at the begin of the step, where nothing keeps it whole.
  void look(const std::vector<double>& before, const std::vector<double>& x);

  // Particle, triangle and side of each passage that is left (C, 3); of edges, numbered after
  // the particles, edge, edge and side.
  Out<std::int64_t, 2> ended() const;
  // How many passages there are, and were as the cell began.
  std::size_t crossings() const { return corners_.crossed.size() + edges_.crossed.size(); }
  std::size_t begun_crossings() const { return begun_corners_.size() + begun_edges_.size(); }
  // What is through, at most at the end of any cell that was noted.
  void note_through();
  SelfThrough through() const { return {passed_, cut_, rate_needed_}; }

 private:
  // Where particles were when pairs were looked for, and how far these may have come since.
  struct Listing {
    std::vector<double> at;
    double reach = -1, drift = 0;

    bool covers(double need) const { return need + drift <= reach; }
    void begin(const std::vector<double>& x, double reach0) {
      at = x, reach = reach0, drift = 0;
    }
  };

  void read(const In<std::int64_t, 2>& crossed);
  // Finds what of the marked a step from here leads through each other; whether anything is.
  // These alone are marked then.
  bool passes(double h, const std::vector<double>& from, const std::vector<double>& x,
              std::vector<std::uint8_t>& moved);
  void note_passed();
  void part_passed(double h, std::vector<double>& before, std::vector<double>& x) const;
  // Looks how far near parts go over each other in a step; with cells that are new.
  void measure(double h, const std::vector<double>& before, const std::vector<double>& x);
  void look_around(double h, const std::vector<double>& before, const std::vector<double>& x);
  // Whether all that may come near in the step was in cells beside each other.
  bool cells_cover() const;
  void list(double h, const std::vector<double>& before, const std::vector<double>& x);

  const SpringLayers* layers_;
  const SpringNetwork& network_;
  LayerContacts<TrianglesAndCorners> corners_;
  LayerContacts<EdgesAndEdges> edges_;
  std::optional<Tangles> tangles_;
  std::optional<ImpactZones> zones_;
  std::vector<LayerHit> passed_corners_, passed_edges_;
  std::vector<Passage> begun_corners_, begun_edges_;
  std::int64_t cell_ = -1, passed_ = 0, cut_ = 0;

  Listing listed_, picked_;
  NearMotion motion_;
  std::vector<double> went_;  // since pairs were listed, beside a rigid motion of all
  double longest_ = 0;  // edge, when cells were made
  // Of parts that are near, how far they go over each other in a step, and what of that is
  // looked at.
  double travel_ = 0, most_ = 0, need_ = 0, rate_needed_ = 0;
  double far_ = 0;  // how far all moved over each other since
};

template <class Settle>
void SelfContacts::prevent_piercing(double h, const std::vector<double>& from,
                              std::vector<double>& before, std::vector<double>& x,
                              std::vector<std::uint8_t>& moved, Settle settle) {
  if (!layers_ || !tangles_ || listed_.reach < 0) return;
  corners_.drop_those_back(*layers_, x);
  edges_.drop_those_back(*layers_, x);
  for (int round = 0; passes(h, from, x, moved); ++round) {
    if (round == MAX_ROUNDS) return note_passed();
    if (round < SEPARATION_ROUNDS) {
      part_passed(h, before, x);
      settle();
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
