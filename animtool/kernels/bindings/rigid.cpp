// Python bindings of rigid bodies.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "rigid/bodies.h"

namespace animtool {

void bind_rigid(nb::module_& m) {
  nb::class_<RigidBodies>(m, "RigidBodies",
                          R"(N rigid bodies of S convex shapes, and K joints.

``inertias`` ``(N, 4)``: mass and moments about the principal axes, which are the axes of their
frames; a moment of 0, as about a rod, is ignored. ``bodies`` ``(S,)`` ascend; ``shape_numbers``
``(S, 3)``: rounding radius, restitution and friction. ``points`` ``(P, 3)`` of shape s start at
``point_starts[s]`` ``(S + 1,)``, in the frame of its body, for hulls only corners; its faces start
at ``face_starts[s]``, each with ``corners`` from ``corner_starts[f]`` on, counter-clockwise from
outside. A sphere has one point, a capsule two.

``joints`` ``(K, 3)``: 0 fixed, 1 pin, 2 ball, 3 prismatic, and two bodies; -1 is an animated
frame. ``joint_numbers`` ``(K, 27)``: origin and quaternion x y z w of the frames on both, with x
as the axis; lower and upper limit of angle, slide or twist (lower above upper is unlimited);
half-angles of the swing about y and z (negative is unlimited); target of the drive, and of a
ball's its rotation; its stiffness, damping, and largest force or torque (negative is unlimited).
Bodies of a joint do not collide, nor do the ``excluded_pairs`` ``(P, 2)``.)")
      .def(nb::init<In<double, 2>, In<std::int64_t, 1>, In<double, 2>, In<double, 2>,
                    In<std::int64_t, 1>, In<std::int64_t, 1>, In<std::int64_t, 1>,
                    In<std::int64_t, 1>, In<std::int64_t, 2>, In<double, 2>, In<std::int64_t, 2>>(),
           "inertias"_a, "bodies"_a, "shape_numbers"_a, "points"_a, "point_starts"_a,
           "face_starts"_a, "corner_starts"_a, "corners"_a, "joints"_a, "joint_numbers"_a,
           "excluded_pairs"_a);

  m.def("step_rigid", &step_rigid, WithoutLock(), "bodies"_a, "state"_a, "pairs"_a, "contacts"_a,
        "joint_impulses"_a, "forces"_a, "colliders"_a, "anchors"_a, "step"_a, "method"_a,
        "substeps"_a, "max_iterations"_a, "tolerance"_a, "sleep_speed"_a, "sleep_time"_a,
        R"(Take a step of rigid bodies, in substeps.

``state`` ``(N, 14)``: centre of mass, quaternion x y z w, velocity, angular momentum, and the time
a body has been slow. ``pairs`` ``(M, 2)``, ascending, and ``contacts`` ``(M, 6)``: the two shapes
of contact points, colliders numbered after the shapes, the position on the first body and the
force on it; ``joint_impulses`` ``(K, 12)``: joint impulses. All are those of the previous step, or empty
and 0. ``forces`` ``(N, 6)``: force and torque during the step. ``colliders``: those of
`collide_particles`; ``anchors`` ``(K, 2, 7)``: animated frames at both ends of the step.

``method`` of rotation: 0 splitting, 1 RK4, 2 symplectic Euler, 3 Euler. Velocities are iterated
until they change by less than ``tolerance``, at most ``max_iterations`` times. Bodies slower than
``sleep_speed`` for longer than ``sleep_time`` sleep; 0 is never.

Returns ``(state, pairs, contacts, joint_impulses, deepest, residual, touching, iterations, awake, unsolved,
first, second)``: depth of the deepest contact; last velocity change; number of pressing points;
total iterations; number of awake bodies; substeps that did not converge; the pair of the deepest
contact, -1 if none.)");
}

}  // namespace animtool
