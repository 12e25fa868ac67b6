// Python bindings of springs.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "springs/steps.h"
#include "springs/strands.h"

namespace animtool {

void bind_springs(nb::module_& m) {
  using A = SpringArrays;
  nb::class_<SpringNetwork> network(m, "SpringNetwork",
                                    R"(Particles, springs between them and what acts on them.

Inverse masses ``(N,)`` of particles that are held are 0; ``drags``
``(N,)`` slow them, a second. Springs join ``ends`` ``(S, 2)``; ``limit`` is the length at
which they tear. ``air_drag`` and ``air_lift`` of the air on ``triangles`` ``(T, 3)`` are over
the area and the square of the speed. Over the times of ``knots`` ``(K,)``: where ``held``
particles are ``(K or 1, P, 3)``; the points ``(K or 1, A, 3)`` that ``anchors`` are drawn to;
the wind ``(K or 1, 1, 3)``.)");
  define_class(network,
         Field{"inverse_masses", &A::inverse_masses}, Field{"drags", &A::drags},
         Field{"ends", &A::ends}, Field{"rest", &A::rest}, Field{"stiffness", &A::stiffness},
         Field{"damping", &A::damping}, Field{"limit", &A::limit},
         Field{"triangles", &A::triangles}, Field{"gravity", &A::gravity},
         Field{"air_drag", &A::air_drag}, Field{"air_lift", &A::air_lift},
         Field{"knots", &A::knots}, Field{"held", &A::held}, Field{"held_path", &A::held_path},
         Field{"anchors", &A::anchors}, Field{"anchor_stiffness", &A::anchor_stiffness},
         Field{"anchor_damping", &A::anchor_damping}, Field{"anchor_path", &A::anchor_path},
         Field{"winds", &A::winds});
  network.def("lead", &SpringNetwork::lead, "held_path"_a, "anchor_path"_a,
           "Put paths of held particles and anchors in the place of those over the knots.");

  nb::class_<SpringLayers>(m, "SpringLayers",
                           R"(A surface of springs that keeps apart from itself.

Particles keep the ``thickness`` from triangles, and edges three quarters of it from edges, or
less: as far as they are from each other at ``rest`` ``(N, 3)``, and two thirds of that along
the surface. With Coulomb's
coefficient of ``friction``; the ``speed`` with which what is nearer comes apart.)")
      .def(nb::init<const SpringNetwork&, In<double, 2>, double, double, double>(),
           "network"_a, "rest"_a, "thickness"_a, "friction"_a, "speed"_a)
      .def("least", &SpringLayers::checked_least, "triangle"_a, "particle"_a,
           R"(Return the distance that a particle keeps, 0 from triangles that it is a corner of.)")
      .def("least_of_edges", &SpringLayers::checked_least_of_edges, "first"_a, "second"_a,
           R"(Return the distance that edges keep, 0 of those that share a particle.

Edges are pairs of particles, the lower first, in order.)");

  m.def("part_springs", &part_springs, Unlocked(), "network"_a, "layers"_a, "before"_a,
        "after"_a, "h"_a,
        R"(Take the step of h that a surface is kept apart in from itself.

From positions ``(N, 3)`` to the state ``(2, N, 3)`` returned, of one that knows nothing.)");

  m.def("pierced_edges", &pierced_edges, Unlocked(), "positions"_a, "triangles"_a,
        R"(How many edges go through triangles ``(T, 3)`` that have neither of their ends.

Each pair counts; at ``positions`` ``(N, 3)``.)");

  m.def("spring_order", &spring_order, Unlocked(), "ends"_a, "particles"_a,
        R"(The order ``(S,)`` in which springs ``(S, 2)`` are gone through.

It is that of their particles, but for springs that do not wait for each other: these stand
together, so that several are done at once.)");

  m.def("spring_accelerations", &spring_accelerations, Unlocked(), "network"_a, "t"_a, "h"_a,
        "state"_a, "torn"_a,
        R"(Accelerations ``(N, 3)`` at positions and velocities ``(2, N, 3)`` and a time.

Held particles have none; springs that are ``torn`` ``(S,)`` pull nothing. Speeds of what
anchors are drawn to are those of the h before.)");

  m.def("spring_energy", &spring_energy, Unlocked(), "network"_a, "positions"_a,
        R"(Energy of springs at positions ``(N, 3)``, and their largest length.

Returns ``(energy, longest)``: of those with a length at rest, over that; 0 where there are
none.)");

  m.def("step_springs", &step_springs, Unlocked(), "network"_a, "state"_a, "torn"_a, "origin"_a,
        "first"_a, "cell"_a, "cells"_a, "substeps"_a, "colliders"_a.none(),
        R"(Take semi-implicit Euler steps from a state ``(2, N, 3)``.

Cell i of time begins at ``origin + (first + i) cell`` and is that many substeps.

``colliders``: those of `collide_particles`, their poses at both ends of each cell
``(cells, C, 2, 7)``, the distance that particles keep, how deep each may be in each ``(C, N)``,
0 or less, None is not at all, how much deeper counts as left inside, and meshes whose points
move: a `MeshSurface`, its points at knots of time ``(K, P, 3)``, restitution, friction, margin,
depenetration speed and the speed of what is put elsewhere ``(5,)``, how many cells a knot
lasts, and how many cells of the first are over.

Returns ``(state, torn, unresolved)``: particles left inside colliders at the end.)");

  m.def("project_springs", &project_springs, Unlocked(), "network"_a, "state"_a, "torn"_a,
        "origin"_a, "first"_a, "cell"_a, "cells"_a, "substeps"_a, "calm"_a, "least"_a, "most"_a,
        "stretch"_a, "colliders"_a.none(), "layers"_a.none(), "crossed"_a, "limit"_a = 0.0,
        R"(Take steps of extended position based dynamics, each spring once a step, in order.

Cells are those of `step_springs`. One at whose end a spring is longer than at rest by more
than this ``stretch``, and not mostly by its own give, is crossed again in twice the steps,
up to ``most``; after many that go well half as many are tried, down to ``least``.

``layers`` keep the surface apart from itself; ``crossed`` ``(C, 3)`` are passages to go on
with: a particle, the triangle that it went through, and the side of this that it came from;
or an edge, numbered after the particles, another of a higher number, and its side.

With a ``limit`` above 0 springs that hardly give are brought back to within this strain of
their length at rest at the end of each step, and their ends then neither come apart nor
together; steps are shortened only where that helps.

Returns ``(state, torn, substeps, calm, stretch, steps, touched, unresolved, crossed,
through)``: steps a cell and cells that went well, to go on with; the largest stretch
that is not a spring's own; steps in all; particles that colliders moved in a step, at most;
the passages left; and of what went through the most particles and pairs of edges at the end
of a cell, and how many steps a second would have seen all of it, 0 where these did.)");

  nb::class_<SpringStrands>(m, "SpringStrands",
                            R"(Strands of P particles of one mass, each held at its root.

Lengths at rest of springs along them, ``rests`` ``(S, P - 1)``, which hardly give, and from
each particle to the next but one, ``folds`` ``(S, P - 2)``. ``drag`` is what slows them, a
second. Over the mass: ``stiffness`` along strands, of folds, and of the draw to where the
animation has them, with its damping. ``stretch`` is the share by which springs along strands
may be longer than at rest before a step corrects them once more.)")
      .def(nb::init<In<double, 2>, In<double, 2>, In<double, 1>, double, double, double, double,
                    double, double>(),
           "rests"_a, "folds"_a, "gravity"_a, "drag"_a, "stiffness"_a, "fold_stiffness"_a,
           "draw_stiffness"_a, "draw_damping"_a, "stretch"_a);

  m.def("follow_strands", &follow_strands, Unlocked(), "strands"_a, "targets"_a, "state"_a,
        "span"_a, "substeps"_a, "colliders"_a.none(), "threads"_a = 1,
        R"(Take strands over a frame, from a state ``(2, N, 3)``.

The animation has their particles at ``targets`` ``(cells + 1, N, 3)`` as each even cell of the
time begins and ends, straight between them; roots are there. Steps are those of
`project_springs`, but for the springs along strands, which are solved together. ``colliders``
are those of `step_springs`. How many ``threads`` share the strands makes no difference.

Returns ``(state, touched, unresolved, stretch)``: particles in contact in a step, at most; left
inside at the end; how much longer than at rest a spring along them is there, over that.)");

  m.def("solve_springs", &solve_springs, Unlocked(), "network"_a, "state"_a, "before"_a.none(), "torn"_a,
        "origin"_a, "first"_a, "cell"_a, "cells"_a, "substeps"_a, "two_steps"_a,
        "tolerance"_a, "colliders"_a.none(), "pulls"_a.none() = nb::none(),
        R"(Take implicit steps: of Euler, or backward differences of ``two_steps``.

Cells are those of `step_springs`; ``before`` is the state a step before, None at the
start. Newton's method goes on until a correction moves no particle by more than
``tolerance``; a cell that is not solved is tried in shorter steps. With ``pulls`` ``(H, 6)``,
impulses of the step before on what holds the held particles and their moments about the
origin, 0 at the start, these are returned of all steps and of the last.

Returns ``(state, before, known, torn, steps, corrections, lost, unresolved, pushes, pulls)``:
whether ``before`` is known; steps and corrections taken; whether a cell could not be solved.)");
}

}  // namespace animtool
