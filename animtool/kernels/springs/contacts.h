// Collisions of particles at the end of each substep.
#pragma once

#include <array>
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

// Colliders; their poses at both ends of each interval (intervals, C, 2, 7); the radius of
// particles; allowed signed distances (C, N), at most 0, with rows for moving meshes last, or None;
// the extra depth above which a particle counts as unresolved; and moving meshes.
using SpringColliders =
    std::tuple<ColliderArrays, In<double, 4>, double, std::optional<In<double, 2>>, double,
               std::vector<SpringSurface>>;

// A collider over one step.
struct StepCollider {
  collide::Collider collider;
  collide::Pose begin, end;
  // A capsule or sphere with particles outside; for other shapes only its motion and material.
  collide::MovingCapsule capsule;
  bool is_capsule;
  // For a mesh whose points move: its index, the elapsed fraction of its knot interval at the start
  // of the step, the length of the step in that fraction, and the largest displacement of a point.
  std::int32_t surface = -1;
  double elapsed = 0, duration = 0, max_point_shift = 0;

  bool is_mesh() const { return collider.shape == collide::Shape::MESH; }
  // Largest displacement of the surface relative to a drift. For shapes other than capsules and
  // spheres the rotation is not included; it adds the angle times the distance from the origin.
  double max_displacement(collide::Vec drift) const;
  double rotation_angle() const { return is_capsule ? 0.0 : collider.motion.angle(); }

  // Distance from the collider at the start and at the end of the step.
  collide::Sample sample_start(collide::Vec point, double radius) const;
  collide::Sample sample_end(collide::Vec point, double radius) const;
  // Largest displacement of a particle that cannot pass through the collider in a step.
  double thickness(double radius) const;
  // Stops a particle whose displacement may cross the collider; returns whether it did. If a
  // velocity is passed, stops that too.
  bool sweep(double h, double radius, collide::Vec from, collide::Vec& to, double* v) const;
};

// The rigid colliders over all intervals of time.
class MovingColliders {
 public:
  MovingColliders(const std::optional<SpringColliders>& colliders, std::size_t particles,
                  std::int64_t interval_count);

  std::size_t size() const { return colliders_.size(); }
  const collide::Collider& operator[](std::size_t c) const { return colliders_[c]; }
  double radius() const { return radius_; }
  double inside_tolerance() const { return inside_tolerance_; }
  // Allowed depths (C, N); null if no particle may be inside.
  const double* depths() const { return depths_; }
  // Number of colliders with allowed depths; surfaces follow rigid colliders.
  std::size_t depth_row_count() const { return depth_row_count_; }
  // Allowed depth of a particle in a collider or surface.
  double depth(std::size_t c, std::size_t n) const {
    return c < depth_row_count_ ? depths_[c * particles_ + n] : 0.0;
  }

  // Whether all colliders start an interval where the previous interval ended.
  bool is_continuous(std::int64_t interval) const;
  // Appends the colliders of each of the equal steps of an interval, of length h.
  void append_steps(std::int64_t interval, int substeps, double h,
                    std::vector<StepCollider>& out) const;

 private:
  StepCollider step_collider(const collide::Collider& c, const collide::Motion& motion,
                             double h) const;
  const double* poses(std::int64_t interval) const {
    return poses_ + static_cast<std::size_t>(interval) * 14 * colliders_.size();
  }

  std::vector<collide::Collider> colliders_;
  std::size_t particles_, depth_row_count_ = 0;
  const double* poses_ = nullptr;
  const double* depths_ = nullptr;
  double radius_ = 0, inside_tolerance_ = 0;
};

// Resolves collisions of particles, edges and faces with all colliders.
class SpringContacts {
 public:
  // With `has_midpoints`, the midpoints of triangle edges collide like particles, and move both
  // ends.
  SpringContacts(const std::optional<SpringColliders>& colliders, const SpringNetwork& network,
                 std::int64_t interval_count, bool has_midpoints = false);

  bool has_colliders() const { return collider_count_ > 0; }
  // Begins an interval of time, with steps of equal length.
  void begin_interval(std::int64_t interval, int substeps, double h);
  // Moves particles out of colliders at the end of a step of an interval, and applies friction to
  // their displacements, and to velocities if given. Particles that started too deep gain no speed:
  // their start position moves too. Returns whether any was moved. With marks, tests only marked
  // particles and edges with a marked end, and marks moved particles.
  bool resolve(int step, std::vector<double>& before, std::vector<double>& x,
               std::vector<double>* v, std::vector<std::uint8_t>* particle_marks = nullptr);
  // Impulses on rigid colliders (C, 7): impulse, moment about the origin, and the largest mass in
  // contact in one step.
  Out<double, 2> impulses() const;
  // Largest number of particles moved in a step, and number that remain inside at the end.
  std::int64_t touched_count = 0, unresolved_count = 0;

 private:
  using PatchHit = MeshPatches::PatchHit;

  // Builds a cache for each collider that is a mesh.
  void build_patches(std::size_t particles);
  // Begins an interval for moving meshes; resets `is_cache_valid` if one teleports.
  void begin_surfaces(std::int64_t interval, bool& is_cache_valid);
  // Builds the colliders of all steps of the interval, with moving meshes.
  void add_surfaces();
  // Collides the edges and faces of nearby particles; marks the particles that it moves.
  bool resolve_faces(StepState state, std::vector<std::uint8_t>* particle_marks);
  // Collides the midpoints of edges, given the largest displacement and rotation of colliders.
  void resolve_midpoints(double max_displacement, double max_angle, StepState state,
                         std::vector<std::uint8_t>* particle_marks);
  // A triangle, the collider of a moving mesh, and a node of it with fine points. In a step, the
  // nearest of these, the distance beyond the contact distance, negative if unknown, and the
  // offsets of the corners from that point.
  struct FineTriangle {
    std::size_t corner, collider;
    std::int32_t node, point;
    double clearance;
    std::array<collide::Vec, 3> offsets;
  };

  // Lists the triangles that fine points of moving meshes may touch in the interval.
  void list_fine_triangles(const StepState& state);
  // Collides the points of triangles that are nearest to fine points of moving meshes.
  void resolve_fine_points(StepState state, std::vector<std::uint8_t>* particle_marks);
  // Finds the fine point nearest to a triangle; returns its distance, at most twice the contact
  // distance.
  double find_fine_point(FineTriangle& fine, const StepState& state) const;
  // Whether a triangle moved less than its clearance since the last search.
  bool is_clear(const FineTriangle& fine, const StepState& state) const;
  // Collides the point of a triangle that is nearest to a point; returns whether it moved.
  bool resolve_triangle_point(std::size_t c, const std::int32_t* corners, collide::Vec nearby,
                              StepState& state, std::vector<std::uint8_t>* particle_marks);
  // Allowed depth of a particle, or of a midpoint, in a collider.
  double depth(std::size_t c, std::size_t n) const;
  // Resolves all contacts of a particle and updates its clearance; returns whether it moved.
  bool resolve_particle(std::size_t n, double mass, double* before, double* x, double* v);
  // Pushes a particle out of one collider; returns whether it moved.
  bool push(std::size_t c, std::size_t n, collide::Vec before, collide::Vec& x,
            collide::Vec& reference, double* v);
  void flip_if_crossed(const StepCollider& c, collide::Vec from, collide::Vec to,
                       collide::Sample& hit) const;
  bool sweep(std::size_t c, std::size_t n, collide::Vec from, collide::Vec& to, double* v);
  bool sweep_mesh(std::size_t c, std::size_t n, collide::Vec from, collide::Vec& to, double* v);
  // Distance of a particle from a collider at the start or end of the step.
  PatchHit query(std::size_t c, std::size_t n, bool is_at_end, collide::Vec point);
  collide::Mesh mesh_at(const StepCollider& c, bool is_at_end) const;
  // Displacement of the surface at a point over the step.
  collide::Vec surface_displacement(const StepCollider& c, const PatchHit& hit, bool is_at_end,
                                    collide::Vec point) const;
  // Records the impulse of a collider on a particle.
  void record_impulse(std::size_t c, double mass, collide::Vec point, collide::Vec change);
  // Smallest distance of a particle from all colliders beyond the allowed depth; negative inside.
  double clearance(std::size_t n, collide::Vec x);
  void update_clearance(std::size_t n, collide::Vec x, double distance);

  const SpringNetwork& network_;
  MovingColliders colliders_;
  FaceContacts faces_;
  std::vector<std::int32_t>
      particles_near_colliders_;  // particles whose edges may touch colliders in this step
  std::vector<MovingSurface> surfaces_;
  std::vector<FineTriangle> fine_triangles_;
  std::size_t collider_count_;
  std::int64_t interval_count_;
  bool has_midpoints_;
  std::vector<double> contact_distances_;  // of each collider
  // Caches of colliders that are meshes, and the index of each collider's cache, -1 for others.
  std::vector<MeshPatches> patches_;
  std::vector<std::int32_t> patch_indices_;
  std::vector<StepCollider> rigid_steps_,
      interval_steps_;  // (substeps, C), without and with moving meshes
  const StepCollider* step_colliders_ = nullptr;
  int substeps_ = 1;
  double h_ = 0, min_impact_speed_ = 0;
  // Smallest distance in an iteration, beyond the allowed depth.
  double nearest_distance_ = 0;
  std::int64_t last_interval_ = -1;
  // Impulses of earlier intervals, and of the current one, which may be repeated (C,
  // IMPULSE_WIDTH).
  std::vector<double> past_impulses_, interval_impulses_;
  std::vector<double> masses_;  // masses that touched colliders in this step (C,)
  // Lower bound of the distance from all colliders, of each particle and then each midpoint; and
  // its largest distance from the origins of colliders, about which they rotate.
  std::vector<double> clearances_, lever_arms_;
  // Clearances and arms at the start of the interval.
  std::vector<double> start_clearances_, start_lever_arms_;
};

}  // namespace animtool
