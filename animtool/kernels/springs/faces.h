// Edges and faces of surfaces against collider features finer than the cloth cells.
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

// Features of a collider in its frame: points, lines between them, and their radius [m].
struct FineFeatures {
  std::vector<collide::Vec> points;
  std::vector<std::array<std::int32_t, 2>> lines;
  double radius = 0;
  bool is_built = true;
  // For a mesh: lines and points of each triangle, -1 for none.
  std::vector<std::array<std::int32_t, 6>> of_triangle;

  bool any() const { return !points.empty(); }
};

// A step of all particles; velocities where the solver has them.
struct StepRows {
  std::vector<double>&before, &x;
  std::vector<double>* v;
};

class FaceContacts {
 public:
  FaceContacts(const SpringElements& elements, double radius);

  // Adds the next collider; returns whether any has fine features.
  void add(const collide::Collider& c);
  // Adds a collider that collides only with particles.
  void skip() { features_.emplace_back(); }
  bool any() const { return any_; }
  // Edges and faces of a particle this far from all colliders over a step cannot touch them.
  double reach() const { return any_ ? reach_ : -collide::FAR; }

  // Moves edges and faces out of the features of a collider; returns whether any moved.
  // Moved particles are recorded with their change of velocity.
  bool resolve(std::size_t index, const StepCollider& c, double h,
               const std::vector<std::int32_t>& near, StepRows rows);
  struct MovedParticle {
    std::int32_t particle;
    double shift;
    collide::Vec change;
  };
  std::vector<MovedParticle> moved;

 private:
  struct Element {
    FourParticles corners;  // indices in `from_`; two for an edge
    int count;
    collide::Vec low, high;  // about its way
  };

  bool is_near(const StepCollider& c, const std::vector<std::int32_t>& near,
               const StepRows& rows) const;
  bool collect_elements(const FineFeatures& features, const StepCollider& c,
                        const std::vector<std::int32_t>& near, const StepRows& rows);
  std::int32_t slot(std::int32_t particle, const StepCollider& c, const StepRows& rows);
  void add_element(const std::int32_t* corners, int count, const StepCollider& c,
                   const StepRows& rows);
  // The contacts that are possible in the step, at the current positions.
  void find_contacts(const FineFeatures& features, const StepCollider& c);
  void add_contacts(const FineFeatures& features, const Element& one, std::int32_t feature);
  template <class Shape>
  void add_pair(const FourParticles& who, double distance);
  bool separate(Separation& separation) const;
  void write(const StepCollider& c, double h, StepRows& rows);

  const SpringElements& network_;
  double radius_, reach_ = 0;
  bool any_ = false;
  std::vector<FineFeatures> features_;  // of each collider
  // Of this step: particles in a row, after these points of the collider.
  std::vector<std::int32_t> slots_, particles_;
  std::vector<std::uint8_t> marked_;
  std::vector<double> from_, to_, start_, end_, inverse_masses_;
  std::vector<Element> elements_;
  std::vector<LayerHit> edges_, corners_;
};

}  // namespace animtool
