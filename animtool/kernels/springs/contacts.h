// Collisions of particles at the end of each substep.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "colliders/arrays.h"
#include "colliders/colliders.h"
#include "colliders/wide.h"
#include "springs/faces.h"
#include "springs/meshes.h"
#include "springs/network.h"

namespace animtool {

// Colliders; their poses at both ends of each cell (cells, C, 2, 7); the radius of particles;
// allowed signed distances (C, N), at most 0, with rows for meshes at the end, or None; the
// extra depth that counts as unresolved; and moving meshes.
using SpringColliders =
    std::tuple<ColliderArrays, In<double, 4>, double, std::optional<In<double, 2>>, double,
               std::vector<SpringSurface>>;

// A collider over one step.
struct StepCollider {
  collide::Collider collider;
  collide::Pose begin, end;
  // For a capsule or sphere with particles outside: all of it; for others: its motion.
  collide::Rod rod;
  bool is_rod;
  // For a mesh whose points move: its index, the elapsed fraction of its knot interval at the
  // start of the step, the fraction of the step, and the largest displacement of a point.
  std::int32_t surface = -1;
  double elapsed = 0, duration = 0, shift = 0;

  bool is_mesh() const { return collider.shape == collide::Shape::MESH; }
  // Largest displacement of its surface, relative to a drift; for colliders other than rods
  // without the rotation, which adds to it with the arm from the origin.
  double travel(collide::Vec drift) const;
  double rotation() const { return is_rod ? 0.0 : collider.motion.angle(); }

  // Distances and directions out at the start and the end of the step.
  collide::Sample before(collide::Vec point, double radius) const;
  collide::Sample after(collide::Vec point, double radius) const;
  // A longer displacement may pass through the collider within the step.
  double thickness(double radius) const;
  // Stops a particle whose displacement may cross the collider; returns whether it did. With
  // a velocity, that is stopped too.
  bool sweep(double h, double radius, collide::Vec from, collide::Vec& to, double* v) const;
};

// Colliders over cells of time.
class MovingColliders {
 public:
  MovingColliders(const std::optional<SpringColliders>& colliders, std::size_t particles,
                  std::int64_t cells);

  std::size_t size() const { return colliders_.size(); }
  const collide::Collider& operator[](std::size_t c) const { return colliders_[c]; }
  double radius() const { return radius_; }
  double tolerance() const { return tolerance_; }
  // Allowed depths (C, N); null if none may be inside.
  const double* depths() const { return depths_; }
  // Allowed depth of a particle in a collider, or in a surface; surfaces follow colliders.
  std::size_t depth_rows() const { return depth_rows_; }
  double depth(std::size_t c, std::size_t n) const {
    return c < depth_rows_ ? depths_[c * particles_ + n] : 0.0;
  }

  // Whether all colliders start a cell where they ended the last one.
  bool is_continuous(std::int64_t cell) const;
  // One of the even steps of a cell, of length h.
  void steps(std::int64_t cell, int substeps, double h, std::vector<StepCollider>& out) const;

 private:
  StepCollider step_collider(const collide::Collider& c, const collide::Motion& motion,
                             double h) const;
  const double* poses(std::int64_t cell) const {
    return poses_ + static_cast<std::size_t>(cell) * 14 * colliders_.size();
  }

  std::vector<collide::Collider> colliders_;
  std::size_t particles_, depth_rows_ = 0;
  const double* poses_ = nullptr;
  const double* depths_ = nullptr;
  double radius_ = 0, tolerance_ = 0;
};

class SpringContacts {
 public:
  // With `midpoints`, the midpoints of triangle edges are kept out like particles, and move both
  // ends.
  SpringContacts(const std::optional<SpringColliders>& colliders, const SpringNetwork& network,
                 std::int64_t cells, bool midpoints = false);

  bool any() const { return count_ > 0; }
  // Begins a cell of time, with steps of equal length.
  void begin_cell(std::int64_t cell, int substeps, double h);
  // Moves particles out of colliders at the end of a step of a cell, and applies friction to
  // their displacements, and to velocities if given. Particles that started too deep gain no
  // speed: their start position moves too. Returns whether any was moved. With marks, tests only
  // marked particles, and edges with one; moved particles are marked.
  bool resolve(int step, std::vector<double>& before, std::vector<double>& x,
               std::vector<double>* v, std::vector<std::uint8_t>* marks = nullptr);
  // Impulses on rigid colliders (C, 7): impulse and moment about the origin, and the largest
  // mass in contact in one step.
  Out<double, 2> impulses() const;
  // Largest number of particles moved in a step, and number left inside at the end.
  std::int64_t touched = 0, unresolved = 0;

 private:
  using PatchHit = MeshPatches::PatchHit;

  void make_patches(std::size_t particles);
  void begin_surfaces(std::int64_t cell, bool& known);
  void add_surfaces();
  // Collides the edges and faces of nearby particles.
  bool resolve_faces(StepRows rows);
  // Collides midpoints of edges, given the displacement of colliders, and the arm of rotations.
  void resolve_midpoints(double travel, double angle, StepRows rows,
                         std::vector<std::uint8_t>* marks);
  double depth(std::size_t c, std::size_t n) const;
  // Returns whether a particle is moved; also updates its distances from all colliders.
  bool resolve_particle(std::size_t n, double mass, double* before, double* x, double* v);
  bool push(std::size_t c, std::size_t n, collide::Vec before, collide::Vec& x,
            collide::Vec& unmoved, double* v);
  void flip_if_crossed(const StepCollider& c, collide::Vec from, collide::Vec to,
                       collide::Sample& hit) const;
  bool sweep(std::size_t c, std::size_t n, collide::Vec from, collide::Vec& to, double* v);
  bool sweep_mesh(std::size_t c, std::size_t n, collide::Vec from, collide::Vec& to, double* v);
  // Distance of a particle from a collider at the start or end of the step.
  PatchHit query(std::size_t c, std::size_t n, bool end, collide::Vec point);
  collide::Mesh mesh_at(const StepCollider& c, bool end) const;
  // Displacement of the surface there in the step.
  collide::Vec transported(const StepCollider& c, const PatchHit& hit, bool end,
                           collide::Vec point) const;
  // Records the impulse of a collider on a particle.
  void record_impulse(std::size_t c, double mass, collide::Vec point, collide::Vec change);
  // Distance of the nearest collider, negative inside.
  double clearance(std::size_t n, collide::Vec x);
  void update_clearance(std::size_t n, collide::Vec x, double clear);

  const SpringNetwork& network_;
  MovingColliders colliders_;
  FaceContacts faces_;
  std::vector<std::int32_t> nearby_;  // particles whose edges may be at colliders in this step
  std::vector<MovingSurface> surfaces_;
  std::size_t count_;
  std::int64_t cells_;
  bool has_midpoints_;
  std::vector<double> contact_distances_;  // from each collider
  // Cache of each collider that is a mesh; empty for others.
  std::vector<MeshPatches> patches_;
  std::vector<std::int32_t> patched_;
  std::vector<StepCollider> rigid_, cell_;  // (substeps, C), without and with surfaces
  const StepCollider* step_colliders_ = nullptr;
  int substeps_ = 1;
  double h_ = 0, min_impact_speed_ = 0;
  // Smallest distance in an iteration, beyond the allowed depth.
  double nearest_ = 0;
  std::int64_t last_ = -1;
  // Impulses of earlier cells, and of the current one, which may be repeated (C, PUSH).
  std::vector<double> past_impulses_, cell_impulses_;
  std::vector<double> masses_;  // masses that touched colliders in this step (C,)
  // Lower bound of the distance from all colliders, of each particle and then each midpoint, and
  // the arm by which rotations reach it.
  std::vector<double> clearances_, arms_;
  // The same at the start of the cell.
  std::vector<double> start_clearances_, start_arms_;
};

}  // namespace animtool
