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

// Colliders, their poses at both ends of each cell (cells, C, 2, 7), the distance that
// particles keep, allowed signed distances (C, N), at most 0, None for none, followed by rows
// for meshes; the extra depth that counts as unresolved; and moving meshes.
using SpringColliders =
    std::tuple<ColliderArrays, In<double, 4>, double, std::optional<In<double, 2>>, double,
               std::vector<SpringSurface>>;

// A collider over one step.
struct StepCollider {
  collide::Collider collider;
  collide::Pose begin, end;
  // Of a capsule or a ball with particles outside, all of it; of others, how it moves.
  collide::Rod rod;
  bool is_rod;
  // Of a mesh whose points move: its index, the elapsed fraction of its knot as the step
  // begins, the fraction that the step takes, and the largest displacement of a point.
  std::int32_t surface = -1;
  double begun = 0, lasts = 0, shift = 0;

  bool is_mesh() const { return collider.shape == collide::Shape::MESH; }
  // How far its surface goes at most, beside a drift; of what is no rod without its turn, by
  // the arm from its origin.
  double travel(collide::Vec drift) const;
  double rotation() const { return is_rod ? 0.0 : collider.motion.angle(); }

  // Distances and ways out as the step begins and as it ends.
  collide::Sample before(collide::Vec point, double radius) const;
  collide::Sample after(collide::Vec point, double radius) const;
  // A way longer than this may lead through within the step.
  double thickness(double radius) const;
  // Stops a particle whose displacement may cross the collider; returns whether it did. With
  // a velocity, that is stopped too.
  bool sweep(double h, double radius, collide::Vec from, collide::Vec& to,
             double* v) const;
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
  // How deep a particle may be in one of them, or of the surfaces after these.
  std::size_t depth_rows() const { return depth_rows_; }
  double depth(std::size_t c, std::size_t n) const {
    return c < depth_rows_ ? depths_[c * particles_ + n] : 0.0;
  }

  // Whether all colliders start a cell where they ended the last one.
  bool goes_on(std::int64_t cell) const;
  // One of the even steps of a cell, of length h.
  void steps(std::int64_t cell, int substeps, double h, std::vector<StepCollider>& out) const;

 private:
  StepCollider over(const collide::Collider& c, const collide::Motion& motion, double h) const;
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
  // With middles those of edges of triangles are kept out as particles are, and take their
  // ends along.
  SpringContacts(const std::optional<SpringColliders>& colliders, const SpringNetwork& network,
                 std::int64_t cells, bool middles = false);

  bool any() const { return count_ > 0; }
  // A cell of time begins; its steps are even.
  void begin_cell(std::int64_t cell, int substeps, double h);
  // Moves particles out of what they are in at the end of a step of a cell, and takes what
  // friction does from their way; with velocities, from these too. What began too deep is
  // given no speed by that: where it was goes with it. Returns whether any was moved. With
  // marks only those particles, and edges that have one, are looked at; what is moved is
  // marked.
  bool settle(int step, std::vector<double>& before, std::vector<double>& x,
              std::vector<double>* v, std::vector<std::uint8_t>* marks = nullptr);
  // Impulses on rigid colliders (C, 7): impulse and moment about the origin, and the largest
  // mass in contact in one step.
  Out<double, 2> pushes() const;
  // Particles that were moved in a step, at most, and that were left inside at the end.
  std::int64_t touched = 0, unresolved = 0;

 private:
  using PatchHit = MeshPatches::PatchHit;

  void make_patches(std::size_t particles);
  void enter_surfaces(std::int64_t cell, bool& known);
  void add_surfaces();
  // Edges and faces, of particles that are near.
  bool settle_faces(StepRows rows);
  // The middles of edges, by the way that colliders and what turns reach go in the step.
  void settle_middles(double travel, double angle, StepRows rows,
                      std::vector<std::uint8_t>* marks);
  double depth(std::size_t c, std::size_t n) const;
  // Whether it is moved; looks how far off all colliders are then.
  bool settle_one(std::size_t n, double mass, double* before, double* x, double* v);
  bool push(std::size_t c, std::size_t n, collide::Vec before, collide::Vec& x,
            collide::Vec& unmoved, double* v);
  void push_back_out(const StepCollider& c, collide::Vec from, collide::Vec to,
                 collide::Sample& hit) const;
  bool sweep(std::size_t c, std::size_t n, collide::Vec from, collide::Vec& to, double* v);
  bool sweep_mesh(std::size_t c, std::size_t n, collide::Vec from, collide::Vec& to, double* v);
  // A collider as a particle sees it as the step begins or ends.
  PatchHit look(std::size_t c, std::size_t n, bool end, collide::Vec point);
  collide::Mesh mesh_at(const StepCollider& c, bool end) const;
  // How what is found there goes in the step.
  collide::Vec transported(const StepCollider& c, const PatchHit& hit, bool end,
                       collide::Vec point) const;
  // Takes note of what a collider does to a particle there.
  void note_push(std::size_t c, double mass, collide::Vec point, collide::Vec change);
  // How far off the nearest collider is, less than 0 inside.
  double clearance(std::size_t n, collide::Vec x);
  void note(std::size_t n, collide::Vec x, double clear);

  const SpringNetwork& network_;
  MovingColliders colliders_;
  FaceContacts faces_;
  std::vector<std::int32_t> near_;  // particles whose edges may be at colliders in this step
  std::vector<MovingSurface> surfaces_;
  std::size_t count_;
  std::int64_t cells_;
  bool middles_;
  std::vector<double> kept_;  // from each collider
  // Of each collider that is a mesh, by number; of others none.
  std::vector<MeshPatches> patches_;
  std::vector<std::int32_t> patched_;
  std::vector<StepCollider> rigid_, cell_;  // (substeps, C), without and with surfaces
  const StepCollider* now_ = nullptr;
  int substeps_ = 1;
  double h_ = 0, least_blow_ = 0;
  // The nearest that a round of pushes met, beyond what may be inside.
  double nearest_ = 0;
  std::int64_t last_ = -1;
  // Pushes of the cells before, and of this one, which may be crossed again (C, PUSH).
  std::vector<double> pushed_, pushing_;
  std::vector<double> masses_;  // that touched colliders in this step (C,)
  // How far each particle, and behind these each middle, is from all colliders at least, and
  // what turns reach it by.
  std::vector<double> clear_, arm_;
  // The same as the cell began.
  std::vector<double> begun_clear_, begun_arm_;
};

}  // namespace animtool
