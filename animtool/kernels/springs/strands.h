// Strands: rows of particles of equal mass, pinned at their roots.
#pragma once

#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "springs/bundle.h"
#include "springs/contacts.h"

namespace animtool {

// states (2, N, 3); largest number of particles in contact in a step, and number inside colliders
// at the end; largest strain
using StrandResult = std::tuple<Out<double, 3>, std::int64_t, std::int64_t, double>;

// Rigid colliders of the carrier, with which only particles collide: index of the first, and count.
using CarrierColliders = std::pair<std::size_t, std::size_t>;

// Strands with equal numbers of particles, and their constants.
class SpringStrands {
 public:
  SpringStrands(In<double, 2> spring_rest_lengths, In<double, 2> fold_rest_lengths,
                In<double, 1> gravity, double drag, double stiffness, double fold_stiffness,
                double goal_stiffness, double goal_damping, double max_strain);

  std::size_t strand_count() const { return strands_; }
  std::size_t point_count() const { return points_; }

  // Segments of strands, and the index of those of a strand; strands with similar spring lengths
  // share them.
  const std::vector<SpringElements>& segments() const { return segments_; }
  std::size_t segments_of(std::size_t strand) const { return group_of_strand_[strand]; }

  // Constants of a frame that is divided into intervals of several steps.
  StrandSteps plan_frame(std::size_t interval_count, std::size_t substeps,
                         double frame_duration) const;

  // Rest lengths of the springs along and across the strands of a bundle.
  const double* rest_lengths(std::size_t bundle) const {
    return rest_lengths_.data() + bundle * SIMD_WIDTH * spring_count();
  }
  const double* bend_lengths(std::size_t bundle) const {
    return bend_lengths_.data() + bundle * SIMD_WIDTH * points_;
  }

 private:
  std::size_t spring_count() const { return points_ - 1; }

  std::size_t strands_, points_;
  double gravity_[3], drag_, stiffness_, bend_stiffness_, goal_stiffness_, goal_damping_,
      max_strain_;
  std::vector<double> rest_lengths_, bend_lengths_;  // by bundle, four interleaved
  std::vector<SpringElements> segments_;
  std::vector<std::size_t> group_of_strand_;  // index in `segments_`

  void group_segments(In<double, 2> spring_rest_lengths);
};

StrandResult follow_strands(const SpringStrands& strands, In<double, 3> targets,
                            In<double, 3> state, double frame_duration, int substeps,
                            const std::optional<SpringColliders>& colliders,
                            std::size_t thread_count, const CarrierColliders& carrier_colliders);

}  // namespace animtool
