// Python bindings of rigid bodies.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "rigid/bodies.h"

namespace animtool {

void bind_rigid(nb::module_& m) {
  nb::class_<RigidBodies>(m, "RigidBodies",
                          R"(N rigid bodies of S convex shapes, and K joints.

``inertias`` ``(N, 4)``: mass and moments about the principal axes, which are the axes of their
frames; a moment of 0, as about a rod, takes no part. ``bodies`` ``(S,)`` ascend; ``numbers``
``(S, 3)``: radius about the points, restitution and friction. ``points`` ``(P, 3)`` of shape s
are those from ``point_starts[s]`` ``(S + 1,)`` on, in the frame of its body, of hulls only
corners; its faces those from ``face_starts[s]`` on, each of the ``corners`` from
``corner_starts[f]`` on, counter-clockwise from outside. A ball has one point, a capsule two.

``joints`` ``(K, 3)``: 0 fixed, 1 pin, 2 ball, 3 prismatic, and two bodies; -1 is a frame that
the animation moves. ``joint_numbers`` ``(K, 27)``: origin and quaternion x y z w of the frames
on both, whose x is the axis; least and most of angle, slide or twist (least above most is any);
half-angles of the swing about y and z (below 0 is any); target of the drive, and of a ball's its
rotation; its stiffness, its damping, and its most force or torque (below 0 is any). Bodies that
a joint joins do not meet, nor do the pairs ``apart`` ``(P, 2)``.)")
      .def(nb::init<In<double, 2>, In<std::int64_t, 1>, In<double, 2>, In<double, 2>,
                    In<std::int64_t, 1>, In<std::int64_t, 1>, In<std::int64_t, 1>,
                    In<std::int64_t, 1>, In<std::int64_t, 2>, In<double, 2>,
                    In<std::int64_t, 2>>(),
           "inertias"_a, "bodies"_a, "numbers"_a, "points"_a, "point_starts"_a, "face_starts"_a,
           "corner_starts"_a, "corners"_a, "joints"_a, "joint_numbers"_a, "apart"_a);

  m.def("step_rigid", &step_rigid, Unlocked(), "bodies"_a, "state"_a, "pairs"_a, "contacts"_a,
        "held"_a, "forces"_a, "colliders"_a, "anchors"_a, "step"_a, "method"_a, "substeps"_a,
        "rounds"_a, "tolerance"_a, "drowsy"_a, "rest"_a,
        R"(Take a step of rigid bodies, in some smaller ones.

``state`` ``(N, 14)``: centre of mass, quaternion x y z w, velocity, angular momentum, and for how
long a body has been slow. ``pairs`` ``(M, 2)``, ascending, and ``contacts`` ``(M, 6)``: of points
of contact the shape and the other one, colliders behind the shapes, the place on the first body
and the force on it there; ``held`` ``(K, 12)``: what joints hold. All are those of the step
before, or empty and 0. ``forces`` ``(N, 6)``: force and torque through the step. ``colliders``:
those of `collide_particles`; ``anchors`` ``(K, 2, 7)``: the frames of the animation at both ends
of the step.

``method`` of turning: 0 splitting, 1 RK4, 2 symplectic Euler, 3 Euler. Velocities are corrected
until a correction changes none by more than the ``tolerance``, ``rounds`` times at most. What is
slower than ``drowsy`` for longer than ``rest`` sleeps, but where 0.

Returns ``(state, pairs, contacts, held, deepest, residual, touching, rounds, awake, unsolved,
first, second)``: depth of the deepest contact; change of the last corrections; points that press;
corrections in all; bodies that are awake; small steps that did not reach the tolerance; the pair
of the deepest contact, -1 where there is none.)");
}

}  // namespace animtool
