// Arrays of rigid bodies, from and to Python; see `rigid/world.h` for the step itself.
#pragma once

#include "colliders/arrays.h"
#include "rigid/world.h"
#include "springs/contacts.h"

namespace animtool {

// Bodies, shapes and joints of a world.
class RigidBodies {
 public:
  RigidBodies(In<double, 2> inertias, In<std::int64_t, 1> bodies, In<double, 2> shape_numbers,
              In<double, 2> points, In<std::int64_t, 1> point_starts,
              In<std::int64_t, 1> face_starts, In<std::int64_t, 1> corner_starts,
              In<std::int64_t, 1> corners, In<std::int64_t, 2> joints, In<double, 2> joint_numbers,
              In<std::int64_t, 2> excluded_pairs);

  const rigid::World& world() const { return world_; }

 private:
  void read_joints(const In<std::int64_t, 2>& joints, const In<double, 2>& numbers);

  // Excludes contacts of two bodies, or of a body with a collider.
  void exclude(std::int64_t first, std::int64_t second);

  rigid::World world_;
};

// states, contact pairs, contacts, joint impulses; and the report: see `rigid::Report`
using RigidStepResult =
    std::tuple<Out<double, 2>, Out<std::int64_t, 2>, Out<double, 2>, Out<double, 2>, double, double,
               std::int64_t, std::int64_t, std::int64_t, std::int64_t, std::int64_t, std::int64_t,
               double, std::int64_t>;

RigidStepResult step_rigid(const RigidBodies& bodies, In<double, 2> state,
                           In<std::int64_t, 2> pairs, In<double, 2> contacts,
                           In<double, 2> joint_impulses, In<double, 2> forces,
                           ColliderArrays colliders, In<double, 3> anchors, double step,
                           std::int64_t method, std::int64_t substeps, std::int64_t max_iterations,
                           double tolerance, double sleep_speed, double sleep_time);

}  // namespace animtool
