// Python bindings of springs.
#include <nanobind/stl/pair.h>

#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "springs/steps.h"
#include "springs/strands.h"

namespace animtool {

void bind_springs(nb::module_& m) {
  using Arrays = SpringArrays;
  nb::class_<SpringNetwork> network(m, "SpringNetwork",
                                    R"(Particles, springs between them and external forces.

Inverse masses ``(N,)`` are 0 for pinned particles; ``drags`` ``(N,)`` are [1/s]. Springs join
``ends`` ``(S, 2)``; ``limit`` is the length at which they tear. ``air_drag`` and ``air_lift``
of the ``triangles`` ``(T, 3)`` are per area and squared speed. Over the times of ``knots``
``(K,)``: positions of ``pinned`` particles ``(K or 1, P, 3)``; target points of
``anchors`` ``(K or 1, A, 3)``; the wind ``(K or 1, 1, 3)``.)");
  define_class(network, Field{"inverse_masses", &Arrays::inverse_masses},
               Field{"drags", &Arrays::drags}, Field{"ends", &Arrays::ends},
               Field{"rest", &Arrays::rest}, Field{"stiffness", &Arrays::stiffness},
               Field{"damping", &Arrays::damping}, Field{"limit", &Arrays::limit},
               Field{"triangles", &Arrays::triangles}, Field{"gravity", &Arrays::gravity},
               Field{"air_drag", &Arrays::air_drag}, Field{"air_lift", &Arrays::air_lift},
               Field{"knots", &Arrays::knots}, Field{"pinned", &Arrays::pinned},
               Field{"pinned_path", &Arrays::pinned_path}, Field{"anchors", &Arrays::anchors},
               Field{"anchor_stiffness", &Arrays::anchor_stiffness},
               Field{"anchor_damping", &Arrays::anchor_damping},
               Field{"anchor_path", &Arrays::anchor_path}, Field{"winds", &Arrays::winds});
  network.def("set_paths", &SpringNetwork::set_paths, "pinned_path"_a, "anchor_path"_a,
              "Replace the paths of pinned particles and anchors over the same knots.");

  nb::class_<SpringLayers>(m, "SpringLayers",
                           R"(Self-contact of a spring surface.

Particles keep the ``thickness`` from triangles, and edges three quarters of it from edges, or
less: their distance at ``rest_positions`` ``(N, 3)``, and two thirds of that along the surface. With
Coulomb's coefficient of ``friction``, and the ``separation_speed`` of closer parts.)")
      .def(nb::init<const SpringNetwork&, In<double, 2>, double, double, double>(), "network"_a,
           "rest_positions"_a, "thickness"_a, "friction"_a, "separation_speed"_a)
      .def("distance", &SpringLayers::checked_distance, "triangle"_a, "particle"_a,
           R"(Return the distance that a particle keeps; 0 for its triangles.)")
      .def("edge_distance", &SpringLayers::checked_edge_distance, "first"_a, "second"_a,
           R"(Return the distance that edges keep; 0 if they share a particle.

Edges are pairs of particles, the lower first, in order.)");

  m.def("part_springs", &part_springs, WithoutLock(), "network"_a, "layers"_a, "before"_a,
        "after"_a, "h"_a,
        R"(Resolve self-contact in a step of h.

The step leads from positions ``before`` ``(N, 3)`` to the state ``after`` ``(2, N, 3)``. Returns the
resolved state. No contact history is used.)");

  m.def("pierced_edges", &pierced_edges, WithoutLock(), "positions"_a, "triangles"_a,
        "other_triangles"_a.none() = nb::none(),
        R"(Count intersections of an edge and a triangle ``(T, 3)`` that has neither of its ends.

Particles are at ``positions`` ``(N, 3)``. With ``other_triangles`` ``(U, 3)``, only edges of one mesh through
triangles of the other are counted.)");

  m.def("spring_order", &spring_order, WithoutLock(), "ends"_a, "particles"_a,
        R"(Return the solver order ``(S,)`` of springs ``(S, 2)``.

By particle, with independent springs next to each other, so that several are solved at
once.)");

  m.def("spring_accelerations", &spring_accelerations, WithoutLock(), "network"_a, "t"_a, "h"_a,
        "state"_a, "is_torn"_a,
        R"(Return accelerations ``(N, 3)`` at a state ``(2, N, 3)`` and a time.

They are 0 for pinned particles; torn springs (``is_torn`` ``(S,)``) have no force. Velocities of anchor
targets are those of the preceding h.)");

  m.def("spring_energy", &spring_energy, WithoutLock(), "network"_a, "positions"_a,
        R"(Return the energy of springs at positions ``(N, 3)``, and the largest length ratio.

Returns ``(energy, longest)``: the largest ratio of length to rest length; 0 without springs.)");

  m.def("step_springs", &step_springs, WithoutLock(), "network"_a, "state"_a, "is_torn"_a,
        "origin"_a, "first_interval"_a, "interval_duration"_a, "interval_count"_a, "substeps"_a,
        "colliders"_a.none(),
        R"(Take semi-implicit Euler steps from a state ``(2, N, 3)``.

Interval i begins at ``origin + (first_interval + i) interval_duration`` and has ``substeps`` steps.

``colliders``: those of `collide_particles`, their poses at both ends of each
interval ``(I, C, 2, 7)``, the distance that particles keep, allowed signed distances ``(C, N)``, at
most 0, None for none, the extra depth that counts as unresolved, and moving meshes: a
`MeshSurface`, its points at knots of time ``(K, P, 3)``, restitution, friction, margin,
depenetration speed and teleport speed ``(5,)``, intervals per knot, and elapsed intervals of the
first knot.

Returns ``(state, is_torn, unresolved, impulses)``: particles left inside colliders at the end, and
impulses on colliders.)");

  m.def("project_springs", &project_springs, WithoutLock(), "network"_a, "state"_a, "is_torn"_a,
        "origin"_a, "first_interval"_a, "interval_duration"_a, "interval_count"_a, "substeps"_a,
        "low_strain_count"_a, "min_substeps"_a, "max_substeps"_a, "repeat_strain"_a,
        "colliders"_a.none(), "layers"_a.none(), "initial_intersections"_a, "strain_limit"_a = 0.0,
        R"(Take steps of extended position based dynamics, each spring once per step, in order.

Intervals are those of `step_springs`. If a spring is strained beyond ``repeat_strain`` and its
compliance at the end of an interval, the interval is repeated in twice the steps, up to
``max_substeps``; after many intervals with a low strain, of which ``low_strain_count`` have passed,
half as many are tried, down to ``min_substeps``.

``layers`` is the self-contact; ``initial_intersections`` ``(C, 3)`` are those to resume with: a
particle, the triangle that it passed through, and the side that it came from; or an edge, numbered
after the particles, another of a higher number, and its side.

A ``strain_limit`` above 0 clamps the strain of stiff springs at the end of each step, and removes the
relative velocity of their ends; steps are shortened only if that helps.

Returns ``(state, is_torn, substeps, low_strain_count, strain, steps, touched, unresolved,
intersections, max_counts, impulses)``: steps per interval and intervals with a low strain, to resume
with; the largest strain beyond compliance; total steps; most particles in contact in a step;
particles left inside; remaining intersections; the largest counts of intersecting particles and pairs
of edges at the end of an interval, and the step rate that would detect all of them, 0 if none was
missed; impulses on colliders.)");

  nb::class_<SpringStrands>(m, "SpringStrands",
                            R"(Strands of P particles of equal mass, pinned at their roots.

Rest lengths of stiff springs along them, ``rests`` ``(S, P - 1)``, and between every second
particle, ``folds`` ``(S, P - 2)``. ``drag`` is [1/s]. Per mass: ``stiffness`` along strands, of
folds, and of the pull to the animation, with its damping. ``stretch`` is the strain along
strands above which a step is corrected once more.)")
      .def(nb::init<In<double, 2>, In<double, 2>, In<double, 1>, double, double, double, double,
                    double, double>(),
           "rests"_a, "folds"_a, "gravity"_a, "drag"_a, "stiffness"_a, "fold_stiffness"_a,
           "draw_stiffness"_a, "draw_damping"_a, "stretch"_a);

  m.def("follow_strands", &follow_strands, WithoutLock(), "strands"_a, "targets"_a, "state"_a,
        "frame_duration"_a, "substeps"_a, "colliders"_a.none(), "thread_count"_a = 1,
        "carrier_colliders"_a = CarrierColliders{0, 0},
        R"(Advance strands over a frame, from a state ``(2, N, 3)``.

``targets`` ``(I + 1, N, 3)`` are animated positions at the ends of even intervals, linear
between them; roots follow them. Steps are those of `project_springs`, except that springs along
strands are solved directly. ``colliders`` are those of `step_springs`; those of the character
itself, the first and the count of ``carrier_colliders``, collide with particles, the other rigid ones
with segments too. The ``thread_count`` does not change the result.

Returns ``(state, touched, unresolved, stretch)``: most particles in contact in a step;
particles left inside at the end; the largest strain along strands at the end.)");

  m.def("solve_springs", &solve_springs, WithoutLock(), "network"_a, "state"_a,
        "earlier_state"_a.none(), "is_torn"_a, "origin"_a, "first_interval"_a,
        "interval_duration"_a, "interval_count"_a, "substeps"_a, "uses_bdf2"_a, "tolerance"_a,
        "colliders"_a.none(), "last_pin_impulses"_a.none() = nb::none(),
        R"(Take implicit steps: of Euler, or with ``uses_bdf2`` backward differences of two steps.

Intervals are those of `step_springs`; ``earlier_state`` is the state a step before, None at the
start. Newton's method iterates until a correction moves no particle by more than
``tolerance``; an interval that is not solved is repeated in shorter steps. With
``last_pin_impulses`` ``(H, 6)``, impulses of the last step on the carriers of pinned particles and their moments
about the origin, 0 at the start, these are returned for all steps and for the last.

Returns ``(state, earlier_state, is_known, is_torn, steps, corrections, unsolved, unresolved,
impulses, pin_impulses)``: whether the earlier state is known; steps and corrections taken; how many
intervals could not be solved.)");
}

}  // namespace animtool
