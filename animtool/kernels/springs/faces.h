// Edges and faces of surfaces against collider features finer than the cloth cells.
//
// Particles collide by themselves. Features that pass between particles are handled here: thin
// balls and rods, edges and corners of boxes and meshes. Tests are continuous over the step,
// in the frame of the collider, where its features are static.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "colliders/colliders.h"
#include "springs/network.h"
#include "springs/separation.h"

namespace animtool {

struct StepCollider;

// Parts of a collider in its frame: points, lines between two, and what is kept from them [m].
struct FineParts {
  std::vector<collide::Vec> points;
  std::vector<std::array<std::int32_t, 2>> lines;
  double kept = 0;
  bool known = true;
  // Of a mesh, the lines and points of each triangle, -1 for none.
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

  // Colliders as they come; whether any has parts that are looked for.
  void add(const collide::Collider& c);
  // One that particles alone collide with.
  void skip() { parts_.emplace_back(); }
  bool any() const { return any_; }
  // A particle this far from all colliders over a step has no edge or face at them.
  double reach() const { return any_ ? reach_ : -collide::FAR; }

  // Moves edges and faces out of the features of a collider; returns whether any moved.
  // Moved particles are recorded with their change of velocity.
  bool settle(std::size_t index, const StepCollider& c, double h,
              const std::vector<std::int32_t>& near, StepRows rows);
  struct Moved {
    std::int32_t particle;
    double shift;
    collide::Vec change;
  };
  std::vector<Moved> moved;

 private:
  struct Element {
    FourParticles corners;  // in `from_`; of an edge two
    int count;
    collide::Vec low, high;  // about its way
  };

  bool comes_near(const StepCollider& c, const std::vector<std::int32_t>& near,
                  const StepRows& rows) const;
  bool mark(const FineParts& parts, const StepCollider& c,
            const std::vector<std::int32_t>& near, const StepRows& rows);
  std::int32_t slot(std::int32_t particle, const StepCollider& c, const StepRows& rows);
  void add_element(const std::int32_t* corners, int count, const StepCollider& c,
                   const StepRows& rows);
  // Those that may meet in the step, as they are now.
  void find(const FineParts& parts, const StepCollider& c);
  void meet(const FineParts& parts, const Element& one, std::int32_t part);
  template <class Shape>
  void meet_four(const FourParticles& who, double kept);
  bool part(Separation& separation) const;
  void write(const StepCollider& c, double h, StepRows& rows);

  const SpringElements& network_;
  double radius_, reach_ = 0;
  bool any_ = false;
  std::vector<FineParts> parts_;  // of each collider
  // Of this step: particles in a row, after these points of the collider.
  std::vector<std::int32_t> slots_, particles_;
  std::vector<std::uint8_t> marked_;
  std::vector<double> from_, to_, begun_, ended_, inverse_masses_;
  std::vector<Element> elements_;
  std::vector<LayerHit> edges_, corners_;
};

}  // namespace animtool
