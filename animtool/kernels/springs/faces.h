// Collisions of edges and faces of surfaces with collider features that are finer than the edges.
//
// Particles collide separately. This handles features that pass between particles: thin spheres
// and capsules, edges and corners of boxes and meshes. Tests are continuous over the step, in
// the frame of the collider, where its features are static.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "colliders/colliders.h"
#include "springs/network.h"
#include "springs/separation.h"

namespace animtool {

struct StepCollider;

// Features of a collider in its local frame: points, lines between them, and their radius [m].
struct FineFeatures {
  std::vector<collide::Vec> points;
  std::vector<std::array<std::int32_t, 2>> lines;
  double radius = 0;
  bool is_built = true;
  // For a mesh: the lines and points of each triangle, -1 for none.
  std::vector<std::array<std::int32_t, 6>> triangle_features;

  bool has_points() const { return !points.empty(); }
};

// Positions of all particles before and after a step; velocities if the solver has them.
struct StepState {
  std::vector<double>&before, &x;
  std::vector<double>* v;
};

// Resolves contacts of the edges and faces of a surface with fine features of rigid colliders.
class FaceContacts {
 public:
  FaceContacts(const SpringElements& elements, double radius);

  // Adds the next collider with its fine features.
  void add(const collide::Collider& c);
  // Adds a collider without fine features.
  void add_without_features() { features_.emplace_back(); }
  bool has_features() const { return has_features_; }
  // Edges and faces of a particle farther than this from all colliders over a step cannot touch
  // them.
  double search_distance() const { return has_features_ ? search_distance_ : -collide::INF; }

  // Moves edges and faces out of the features of a collider; returns whether any moved. Records the
  // moved particles.
  bool resolve(std::size_t index, const StepCollider& c, double h,
               const std::vector<std::int32_t>& near_particles, StepState state);
  // A particle, the length of its displacement, and its change of velocity.
  struct MovedParticle {
    std::int32_t particle;
    double displacement;
    collide::Vec velocity_change;
  };
  std::vector<MovedParticle> moved_particles;

 private:
  struct Element {
    FourParticles corners;  // slots of the corners; two for an edge
    int count;
    collide::Vec low, high;  // bounds over the step
  };

  // Whether an element near some particles may touch a mesh.
  bool may_touch_any(const StepCollider& c, const std::vector<std::int32_t>& near_particles,
                     const StepState& state) const;
  // Collects the elements near a collider, in its frame; returns whether there are any.
  bool collect_elements(const FineFeatures& features, const StepCollider& c,
                        const std::vector<std::int32_t>& near_particles, const StepState& state);
  // Returns the slot of a particle in this step; adds it if it is new.
  std::int32_t find_or_add_slot(std::int32_t particle, const StepCollider& c,
                                const StepState& state);
  void add_element(const std::int32_t* corners, int count, const StepCollider& c,
                   const StepState& state);
  // Finds contacts that are possible in the step, at the current positions.
  void find_contacts(const FineFeatures& features, const StepCollider& c);
  void add_contacts(const FineFeatures& features, const Element& element, std::int32_t feature);
  template <class Shape>
  void add_pair(const FourParticles& particles, double distance);
  // Separates all contacts once; returns whether any elements were too close.
  bool separate(Separation& separation) const;
  // Adds the corrections to the positions and velocities of particles.
  void write_back(const StepCollider& c, double h, StepState& state);

  const SpringElements& network_;
  double radius_, search_distance_ = 0;
  bool has_features_ = false;
  std::vector<FineFeatures> features_;  // of each collider
  // In this step: the slot of each particle, or -1 for none, and the particle of each slot, or -1
  // for points of the collider, which come first or last.
  std::vector<std::int32_t> slot_of_particle_, particle_of_slot_;
  std::vector<std::uint8_t> is_candidate_;  // particles that may touch features of the collider
  std::vector<double> from_, to_, uncorrected_from_, uncorrected_to_, inverse_masses_;
  std::vector<Element> elements_;
  std::vector<LayerHit> edge_hits_, corner_hits_;
};

}  // namespace animtool
