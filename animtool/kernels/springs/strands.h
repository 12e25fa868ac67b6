// Strands: rows of particles of equal mass, pinned at their roots.
#pragma once

#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "springs/bundle.h"
#include "springs/contacts.h"

namespace animtool {

// states (2, N, 3); largest numbers of particles in contact and left inside colliders; largest
// strain
using StrandsFollowed = std::tuple<Out<double, 3>, std::int64_t, std::int64_t, double>;

// Rigid colliders of the carrier, which only particles collide with: index of the first, and count.
using CarrierColliders = std::pair<std::size_t, std::size_t>;

class SpringStrands {
 public:
  SpringStrands(In<double, 2> rests, In<double, 2> folds, In<double, 1> gravity, double drag,
                double stiffness, double fold_stiffness, double draw_stiffness, double draw_damping,
                double stretch);

  std::size_t strands() const { return strands_; }
  std::size_t points() const { return points_; }

  // Segments of strands; strands with similar spring lengths share them, by index.
  const std::vector<SpringElements>& segments() const { return segments_; }
  std::size_t segments_of(std::size_t strand) const { return segments_of_[strand]; }

  // Constants of a frame of cells with a number of steps.
  StrandSteps plan(std::size_t cells, std::size_t substeps, double span) const;

  const double* rests(std::size_t bundle) const {
    return rests_.data() + bundle * WIDE * springs();
  }
  const double* folds(std::size_t bundle) const { return folds_.data() + bundle * WIDE * points_; }

 private:
  std::size_t springs() const { return points_ - 1; }

  std::size_t strands_, points_;
  double gravity_[3], drag_, stiffness_, fold_, draw_, draw_damping_, stretch_;
  std::vector<double> rests_, folds_;  // by bundle, four side by side
  std::vector<SpringElements> segments_;
  std::vector<std::size_t> segments_of_;  // strands

  void group_segments(In<double, 2> rests);
};

StrandsFollowed follow_strands(const SpringStrands& strands, In<double, 3> targets,
                               In<double, 3> state, double span, int substeps,
                               const std::optional<SpringColliders>& colliders, std::size_t threads,
                               const CarrierColliders& own);

}  // namespace animtool
