// Rigid impact zones: particles that move rigidly through a step as a last resort against
// intersection.
//
// X. Provot, Collision and Self-Collision Handling in Cloth Model Dedicated to Design
// Garments, 1997, 5; R. Bridson et al., Robust Treatment of Collisions, Contact and Friction
// for Cloth Animation, 2002, 7.4.
#pragma once

#include <cstdint>
#include <vector>

#include "springs/separation.h"

namespace animtool {

class ImpactZones {
 public:
  explicit ImpactZones(const std::vector<double>& inverse_masses)
      : inverse_masses_(inverse_masses) {}

  // Removes all zones at the start of a step.
  void clear();
  const std::vector<std::int32_t>& members() const { return members_; }
  // Merges the zones of the four particles of each contact.
  void add_contacts(const std::vector<LayerHit>& contacts);
  // Moves each zone by the mean rigid motion of its particles in the step.
  void move_rigidly(const std::vector<double>& from, std::vector<double>& before,
                    std::vector<double>& x);

 private:
  // Returns the first particle of the zone of a particle; adds the particle if it is in none.
  std::int32_t find_root(std::int32_t n);
  void move_zone(const std::int32_t* members, std::size_t count, const std::vector<double>& from,
                 std::vector<double>& before, std::vector<double>& x) const;

  const std::vector<double>& inverse_masses_;
  std::vector<std::int32_t> parents_;  // of particles, -1 outside of zones
  std::vector<std::int32_t> members_;
};

}  // namespace animtool
