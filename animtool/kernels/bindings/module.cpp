// Python bindings of the kernels.
#include "bindings/kernels.h"
#include "rigid/bodies.h"
#include "springs/steps.h"
#include "springs/strands.h"

using namespace animtool;
using namespace nanobind::literals;

NB_MODULE(_kernels, m) {
  // A command ends without collecting what is left, which is no leak.
  nb::set_leak_warnings(false);
  m.doc() = R"(Loops that numpy cannot vectorise. C-contiguous arrays in, new arrays out.

Shapes, indices, counts and settings are checked: what is wrong is a ValueError that begins
with the argument's name. NaN and infinity in coordinates, rotations, weights and values go
through to the results, but where a function says otherwise: keys' times, samples to fit,
points of a mesh, and frames and limits of a chain are finite.)";

  m.def("parse_bvh_rows", &parse_bvh_rows, "text"_a, "columns"_a, "limit"_a, "final"_a,
        R"(Read rows of numbers from the text of a BVH MOTION block.

Reads whole lines until ``limit`` rows are read, a fault is met, or the text has
no further whole line (``final`` says that the text ends with the file). Blank
lines are passed over. CR, LF and CR LF each end a line.

Returns ``(values, row_lines, consumed, lines, fault, found, token)``: float64
``(F, C)``, NaN where the text says NaN or infinity and infinity where a number
overflows float64; the 0-based line of each row; bytes and lines read; the fault
of the line after those (0 none, 1 wrong count, 2 not a number), the numbers
found on it and the word that is none.)");

  m.def("format_bvh_rows", &format_bvh_rows, "values"_a, "decimals"_a,
        R"(Write float64 ``(F, C)`` as lines of decimal numbers, as bytes.

Column c is rounded to ``decimals[c]`` places (0 to 9), trailing zeros dropped.)");

  m.def("evaluate_curves", &evaluate_curves, "first"_a, "times"_a, "values"_a, "kinds"_a,
        "ins"_a, "outs"_a, "at"_a,
        R"(Evaluate C curves with K keys in all, as ``(C, F)``, held outside their keys.

Curve c has the keys ``first[c]`` to ``first[c + 1]``, times ascending. ``kinds`` is
0 hold, 1 linear, 2 cubic, 3 Bezier. ``ins`` and ``outs`` are handles ``(K, 2)``: time
and value from the key. ``at`` is ``(1, F)``, or ``(C, F)`` with times of each curve's
own; ascending times are the quickest. Times of keys are finite and no handle's time is
NaN; values may be anything.)");

  m.def("euler_to_quaternion", &euler_to_quaternion, "values"_a, "columns"_a, "axes"_a,
        "previous"_a,
        R"(Turn Euler angles in degrees into quaternions ``(F, R, 4)``, x y z w.

Rotation r multiplies turns about ``axes[r]`` (0 X, 1 Y, 2 Z) left to right by
``values[:, columns[r]]``; a column of -1 is no turn. Signs are those nearest to
the frame before, the first frame's nearest to ``previous`` ``(R, 4)``.)");

  m.def("quaternion_to_euler", &quaternion_to_euler, "quaternions"_a, "axes"_a,
        R"(Turn quaternions ``(F, R, 4)`` into Euler angles ``(F, R, 3)`` in degrees.

``axes`` ``(R, 3)`` names X, Y and Z once each. Of the equal solutions, each frame
takes the one nearest to the frame before; the first, the one nearest to zero.)");

  m.def("forward_kinematics", &forward_kinematics, "parents"_a, "translations"_a, "rotations"_a,
        "scales"_a.none(), "positions"_a.noconvert(), "linear"_a.noconvert(),
        R"(Fill in the world origin ``(F, J, 3)`` and linear part ``(F, J, 3, 3)`` of joints.

``parents[j] < j``, -1 for a root; local transforms are T R S, scale inherited.)");

  m.def("measure_rounding", &measure_rounding, "parents"_a, "translations"_a, "rotations"_a,
        "scales"_a.none(), "written_translations"_a, "written_rotations"_a,
        "written_scales"_a.none(),
        R"(Bounds of the written joints ``(F, 2, 3)`` and what rounding to float32 moved.

Returns ``(extents, error, frame, joint)``: the largest distance between a joint's
world position in float64 and in the values written, and where it is.)");

  m.def("fit_cubics", &fit_cubics, "values"_a, "bounds"_a, "anchors"_a, "low"_a,
        "high"_a, "straight"_a,
        R"(Keys of cubic segments through samples ``(F, D)``, as few as a greedy search finds.

The Euclidean error at sample i is at most ``bounds[i]``. There is a key on each
of the frames ``anchors``, ascending, first and last excluded. No component leaves
``low`` to ``high`` ``(D,)`` between samples within, and from the frames ``straight``
a straight segment leads to the next. Handles lie at
thirds of a segment in time.

Values are finite, bounds above 0.

Returns ``(frames, ins, outs)``: int64 ``(K,)``, and the offsets of the control
values before and behind each key ``(K, D)``. One key where all samples are within
their bounds of the first.)");

  m.def("point_errors", &point_errors, "points"_a, "true_positions"_a, "true_linear"_a,
        "positions"_a, "linear"_a,
        R"(Largest distance ``(F, J)`` of the points of each joint from where they were.

Points ``(J, P, 3)`` are in the joints' frames; origins ``(F, J, 3)`` and linear
parts ``(F, J, 3, 3)`` are those of `forward_kinematics`.)");

  m.def("skin_linear", &skin_linear, "points"_a, "first"_a, "joints"_a, "weights"_a,
        "transforms"_a, "normalize"_a, "out"_a.noconvert(),
        R"(Fill in points ``(F, V, 3)`` moved by the weighted sum of joints' transforms.

Points are ``(F, V, 3)``, or ``(1, V, 3)`` where they stand still. Vertex v follows
``joints[first[v]:first[v + 1]]`` with the weights beside them. Transforms are
``(F, U, 3, 4)``, for column vectors. ``normalize`` brings results to length 1.)");

  m.def("skin_dual_quaternion", &skin_dual_quaternion, "points"_a, "first"_a, "joints"_a,
        "weights"_a, "rotations"_a, "translations"_a, "stretches"_a.none(), "normalize"_a,
        "out"_a.noconvert(),
        R"(Fill in points ``(F, V, 3)`` moved by the weighted sum of dual quaternions.

As `skin_linear`, with unit quaternions ``(F, U, 4)`` and translations ``(F, U, 3)``. The
first influence of a vertex decides the sign of the others. Symmetric ``stretches``
``(F, U, 3, 3)`` are blended linearly and applied first.)");

  m.def("split_stretch", &split_stretch, "linear"_a,
        R"(Split linear parts ``(F, J, 3, 3)`` into a rotation after a symmetric stretch.

Returns quaternions ``(F, J, 4)`` and stretches ``(F, J, 3, 3)``, which are negative
where the linear part mirrors. A determinant below 1e-10 has quaternion zero and no
stretch.)");

  m.def("add_sparse", &add_sparse, "points"_a, "weights"_a, "first"_a, "columns"_a,
        "offsets"_a, "out"_a.noconvert(),
        R"(Fill in points plus the weighted sum of sparse offsets, as ``(F, V, 3)``.

``out`` may be the points themselves. Points are ``(F or 1, V, 3)``, weights ``(F, C)``. Vertex v has the offsets
``first[v]`` to ``first[v + 1]``, each ``(3,)`` of the column in ``columns``.)");

  m.def("point_extents", &point_extents, "points"_a,
        R"(Least and largest coordinates ``(F, 2, 3)`` of points ``(F, V, 3)``.)");

  m.def("round_points", &round_points, "points"_a, "unit"_a,
        R"(Points ``(F, V, 3)`` over ``unit``, as float32, and what the rounding moved.

Returns ``(rounded, error, frame, vertex)``: what is beyond float32 is its largest
number, and NaN stays NaN with an infinite error; the largest distance of a point from where
it was, times ``unit``, and where.)");

  m.def("build_mesh_tree", &build_mesh_tree, "points"_a, "triangles"_a,
        R"(A tree of boxes over triangles ``(T, 3)`` of points ``(P, 3)``, for distances.

Returns ``(triangles, corner_normals, edge_normals, bounds, nodes)``: the triangles in the
order of the tree, what tells inside from outside at corners ``(P, 3)`` and edges
``(T, 3, 3)``, zero on the rim of an open mesh, and the nodes: boxes ``(M, 6)``, and two
children, or ``-1 - first`` and a count of triangles ``(M, 2)``.)");

  nb::class_<MeshSurface>(m, "MeshSurface",
                          R"(Triangles ``(T, 3)`` whose points move, from where they are ``(P, 3)``.

Its tree is built once, and its boxes are fitted to where the points are.)")
      .def(nb::init<In<double, 2>, In<std::int32_t, 2>>(), "points"_a, "triangles"_a);

  m.def("collide_particles", &collide_particles, "colliders"_a, "before"_a, "after"_a,
        "radii"_a, "begins"_a, "step"_a,
        R"(End a step of N particles where colliders let it end.

``colliders``: ``kinds`` ``(C, 3)`` (0 plane, 1 sphere, 2 capsule, 3 box, 4 mesh; whether it
is a container; a mesh's node), ``sizes`` ``(C, 7)``, ``materials`` ``(C, 4)`` (restitution,
friction, margin, depenetration speed), ``poses`` ``(C, 2, 7)`` at both ends of the step
(origin, quaternion), then points and what `build_mesh_tree` gives of all meshes together.
States ``(2, N, 3)`` are positions and velocities at both ends of the ``step``, or from
where the particle is there on, ``begins`` ``(N,)`` of the step.

Returns ``(state, touches, normals)``: ``(2, N, 3)``; the last collider touched or -1, and
how (0 not, 1 bounced, 2 rests, 3 unresolved) ``(N, 2)``; the way out ``(N, 3)``.)");

  m.def("sample_colliders", &sample_colliders, "colliders"_a, "points"_a, "share"_a, "step"_a,
        R"(Look at C colliders from N points at a share of a step.

Returns ``(distances, normals, velocities)``: ``(C, N)``, less the margins, negative inside;
ways out and velocities of the surfaces ``(C, N, 3)``.)");

  m.def("fluid_steps", &fluid_steps, "colliders"_a, "owners"_a, "bodies"_a, "state"_a,
        "accelerations"_a, "spacing"_a, "density"_a, "viscosity"_a, "cohesion"_a, "sound"_a,
        "step"_a, "parts"_a,
        R"(Where N particles of a fluid are a step [s] later, in some parts of it.

``state`` is positions and velocities ``(2, N, 3)``, ``accelerations`` ``(N, 3)`` [m/s²] last
for the step, ``colliders`` move over it. ``owners`` names the body that each collider is
of, -1 for none ``(C,)``. ``bodies`` ``(B, 13)``: the inverse mass [1/kg], the inverse inertia
(xx, yy, zz, xy, xz, yz), and the centre of mass at both ends of the step [m]. ``sound`` is how fast
pressure goes [m/s], up to a spacing in a part.

Returns ``(state, pressures, impulses, compression)``: pressures are means over the step
``(N,)`` [Pa]; impulses on bodies ``(2, B, 6)`` [N s] with moments about the origin, and
times how long before the end they were; compression is the mean over the particles.)");

  m.def("fluid_densities", &fluid_densities, "colliders"_a, "points"_a, "spacing"_a,
        R"(Densities of a fluid at its particles ``(N, 3)``, over that at rest ``(N,)``.

The first poses of ``colliders`` count, as walls that are as dense as what is before them.)");

  m.def("flock_accelerations", &flock_accelerations, "points"_a, "velocities"_a,
        "members"_a.none(), "others"_a.none(), "radius"_a, "cosine"_a, "nearest"_a,
        "attraction"_a, "alignment"_a, "repulsion"_a, "softening"_a, "period"_a, "most"_a,
        R"(What M members of a flock do by the others that they see ``(M, 3)`` [m/s²].

``members`` and ``others`` index ``points`` ``(N, 3)``; None is all. One sees those within
``radius`` and an angle of its velocity whose ``cosine`` is given (-1 is all around), of
these the ``nearest`` (0 is all), and goes by ``attraction`` to their centre, by
``alignment`` to their mean velocity, and by ``repulsion`` away from each: pairs of a weight
and a radius. ``period`` is where axes begin and their lengths ``(2, 3)``, 0 for none.

Returns ``(accelerations, counts, pairs)``: how many each sees ``(M,)``, and how many pairs
there were to look at; where these are more than ``most``, nothing is done.)");

  m.def("gravity", &gravity, "points"_a, "masses"_a, "constant"_a, "softening"_a, "accuracy"_a,
        R"(Sum what N bodies pull each other by, with Plummer softening.

Body j pulls i by ``constant * masses[j] * d / (d² + softening²)^1.5``. With an ``accuracy``
above 0 (0.1 at most) distant bodies count as cells of an octree with quadrupoles, such that
the root mean square of relative errors is about that; with 0 each pair is summed. Bodies at
one place do not act on each other. Points and masses are finite, no mass is below 0.

Returns ``(accelerations, potentials, rates)``: ``(N, 3)`` [m/s²], ``(N,)`` [m²/s²], and the
largest ``constant * (masses[i] + masses[j]) / (d² + softening²)^1.5`` of each body with
another ``(N,)`` [1/s²], of the tree with those that are near alone.)");

  m.def("molecule_pairs", &molecule_pairs, "points"_a, "box"_a, "reach"_a, "most"_a,
        R"(List the pairs of N molecules within a reach, in a box that goes on at its ends.

Points are finite, from anywhere; no side of ``box`` ``(3,)`` is below twice the reach.

Returns ``(order, starts, partners)``: molecules in an order in which those near are near
``(N,)``; where partners of each of these begin ``(N + 1,)``; and partners, as places of that
order, each pair once, those of a molecule filled up to multiples of four with N. More than
``most`` are refused.)");

  m.def("molecule_forces", &molecule_forces, "points"_a, "order"_a, "starts"_a, "partners"_a,
        "box"_a, "kinds"_a, "forces"_a, "charges"_a.none(), "cutoff"_a, "onset"_a, "damping"_a,
        R"(Sum what N molecules do to each other by a list of `molecule_pairs`.

Two of ``kinds`` a and b have the energy ``forces[a, b, 0] / r¹² - forces[a, b, 1] / r⁶``,
which from the distance ``onset`` on is switched off by a polynomial that ends at ``cutoff``.
``charges`` ``(N,)`` repel by their product, damped by erfc of ``damping`` times the distance
and shifted, with the force, to 0 at the cut-off.

Returns ``(forces, energies, virial)``: ``(N, 3)``, half the energies of the pairs of each
``(N,)``, and the sum of forces times distances. NaN goes through.)");

  m.def("crowd_step", &crowd_step, "points"_a, "velocities"_a, "preferred"_a, "radii"_a,
        "most"_a, "gives"_a, "groups"_a, "does"_a, "starts"_a, "walls"_a, "sight"_a, "nearest"_a,
        "horizon"_a, "space"_a, "push"_a, "headway"_a, "side"_a, "step"_a, "rounds"_a, "enough"_a,
        R"(Where N agents are a step [s] later ``(N, 2)`` [m], and their velocities.

They would go at ``preferred`` ``(N, 2)`` [m/s], slower where less than ``headway`` [s] is
between them and who goes the same way ahead of them, and ``push`` [m/s] away from those
nearer than ``space`` [m] who are not of their group (-1 is none). Where others come against
them or across, they go to the lane that costs least; each lane farther to the left costs
less by ``side``, -1 to 1. No velocity is larger than
``most``, none collides within ``horizon`` [s] with one of the ``nearest`` that are in
``sight`` [m], or if there is none such the least. What each ``does`` is 0 for who walks, 1 for who
stays and 2 for who is gone. ``walls`` ``(M, 4)``
from ``starts`` of each agent on: a unit normal, the least velocity along it, and the least
place along it. Then agents are moved apart, each by its part of what both ``gives``, in ``rounds`` at most, until the largest overlap
is ``enough`` [m].

Returns ``(points, velocities, overlap)``.)");

  m.def("fitting_spans", &fitting_spans, "turns"_a, "parents"_a, "numbers"_a, "places"_a,
        "before"_a, "rest"_a, "feet"_a, "stands"_a, "begins"_a, "wide"_a, "near"_a,
        "standing"_a, "hips"_a,
        R"(Which spans ``wide`` frames long can be interpolated, of F poses ``(F, M, 4)``.

Joints are a chain: ``parents`` ``(S,)`` before each, -1 for none, which of the poses' M
rotations each has (``numbers``, -1 has ``rest``), where it is above the other ``(S, 3)``, and
how its frame is turned there (``before`` ``(S, 4)``). Signs of rotations are continuous. From
the ends of a span joints turn evenly the short way; all are moved then so that the mean of
those ``feet`` that stand ``(F, 2)`` is where it was, by at most ``hips`` [m]. A span fits
where no joint is farther off than ``near`` [m] then, and no foot that stands than
``standing``.

Returns ``(fits, moved)``: of each of ``begins`` ``(B,)``, and of the frames inside
``(B, wide - 1, 3)``; those of a span that does not fit may have any values.)");

  m.def("travel_distances", &travel_distances, "free"_a, "cell"_a, "seeds"_a, "starts"_a,
        R"(How far nodes of a grid are from seeds on ways over free nodes alone ``(R, C)`` [m].

Infinite where no way leads. ``seeds`` are numbers of nodes, and ``starts`` how far these are
from where the ways end.)");

  m.def("fit_face", &fit_face, "neutral"_a, "deltas"_a, "observed"_a, "camera"_a.none(), "poses"_a,
        "weights"_a, "threshold"_a, "smooth"_a, "rest"_a, "enough"_a, "rounds"_a, "warm"_a,
        R"(Fit blend-shape weights and the head's pose to landmarks over frames.

Landmark n of a face is at ``R (neutral[n] + sum of w[s] deltas[s, n]) + t``; ``neutral``
``(1, N, 3)``, or ``(F, N, 3)`` with one a frame. ``observed`` is ``(F, N, 3)`` in that unit, or
with a ``camera`` fx, fy, cx, cy ``(F, N, 2)`` in pixels, in front of it along +Z; NaN is missing. ``poses`` ``(F, 7)``, quaternions x y z w and t, and
``weights`` ``(F, S)`` are where it starts. Weights stay between 0 and 1, their differences
from frame to frame cost ``smooth`` times the square, and they themselves ``rest``; a residual
beyond the ``threshold`` counts for less.

Returns ``(weights, poses, residuals, shares, rounds, change)``: lengths of the residuals
``(F, N)``, NaN where missing, and for how much each counted, 0 to 1; the largest change of a
weight in the last round. Rounds end where it is below ten times ``enough``. A ``warm`` start is
near the solution: outliers are known at once.)");

  m.def("triangulate_points", &triangulate_points, "pixels"_a, "confidences"_a.none(),
        "cameras"_a, "active"_a, "noise"_a, "gate"_a, "condition"_a,
        "detailed"_a,
        R"(Find points from the pixels ``(F, C, M, 2)`` at which C cameras see them.

A pixel of NaN is not seen; ``confidences`` ``(F, C, M)`` weight pixels, and 0 is not seen.
``cameras`` ``(C, 27)``: fx fy cx cy skew [px], k1 k2 p1 p2 k3 k4 k5 k6, the rotation by rows and
the translation [m] that take the world to the camera, width and height [px] or 0. ``active`` ``(F, C)``: cameras that
count. ``noise`` ``(C,)``: standard deviation of a pixel's axis [px]. Observations farther off
than ``gate`` standard deviations are rejected; points whose normal matrix has a larger product
of its trace and its inverse's than ``condition`` are left out.

Returns ``(points, numbers, tallies, residuals, states)``: ``(F, M, 3)`` [m], NaN where fewer
than two cameras agree; ``(F, M, 5)``: root mean square of the used residuals [px] and [m], the
standard error [m], cameras used and cameras that see it; ``(F, C, 8)``: observations, those used,
judged, rejected and outside of the lens's domain, sums of squared residuals [px^2] and [m^2],
observations outside of the image. ``detailed``, else empty: residuals ``(F, C, M, 2)`` [px], and
``(F, C, M)``: 0 not seen, 1 used, 2 rejected, 3 not active, 4 outside of the domain, 5 the point
is not found.)");

  m.def("least_median_residuals", &least_median_residuals, "pixels"_a, "cameras"_a,
        R"(Return the least median of residuals over all pairs of cameras ``(F, M)`` [px].

NaN where fewer than three see a point. Arguments are those of `triangulate_points`.)");

  m.def("curl_noise", &curl_noise, "points"_a, "times"_a, "seed"_a,
        R"(Swirls of size 1 without divergence ``(N, 3)`` at points ``(N, 3)`` and times ``(N,)``.

Between whole times one field goes over into the next.)");

  // Of Python's table a test compares: name, residuals, width of a target, whether what it
  // misses is a length, and whether cyclic coordinate descent heeds it.
  m.attr("IK_GOAL_KINDS") = ik_goal_kinds();

  m.def("place_ik_targets", &place_ik_targets, "targets"_a, "frames"_a, "length"_a,
        R"(Bring targets ``(B, E, W)`` to a chain, in place.

Lengths are divided by ``length``, rotations brought to length 1, one without length to
the identity, and seen from the nodes: ``frames`` ``(E, 4)`` are node_from_joint.)");

  m.def("solve_ik", &solve_ik, "nodes"_a, "numbers"_a, "goals"_a, "goal_numbers"_a, "starts"_a,
        "targets"_a, "sought"_a, "stretches"_a, "rests"_a, "rest_weight"_a,
        "length_tolerance"_a, "angle_tolerance"_a, "damping"_a, "iterations"_a, "restarts"_a,
        "seed"_a, "seconds"_a, "ordered"_a, "warm"_a, "method"_a,
        R"(Solve B inverse kinematics problems of one chain.

``nodes`` ``(N, 4)``: kind (0 pin, 1 slide, 2 ball), parent, first coordinate, whether
that belongs to an earlier node. ``numbers`` ``(N, 18)``: rest rotation by rows, offset,
gain, shift, limits (low, high; of a ball two swings, twist low, high). A pin turns about
its z, a slide goes along it, a ball twists about it. ``goals`` ``(E, 4)``: node, root and
middle of its limb, or -1; level, of which 0 comes first. ``goal_numbers``
``(E, 9 + K)``: offset in two parts, of which the first is a bone of its limb, aim axis,
weights of the kinds. ``targets`` ``(B, E, W)``, which misses are told of: as of
``IK_GOAL_KINDS`` position, quaternion, point to aim at, pole, and what the weights are
multiplied by; ``sought``, the same or nearer by. ``stretches`` ``(B, E)`` scale the bones
on the way to a goal. Lengths are shares of the chain's. ``warm`` starts each problem where
the one before it ended. ``method``: 0 damped least squares, 1 gradient descent, 2 Newton, 3
CCD, 4 FABRIK, without slides; only the first heeds levels, the last two no rest.

Returns ``(coordinates, misses, reports, seconds)``: ``(B, Q)``; what each goal misses
``(B, E, K)``; status (0 reached, 1 nearest, 2 budget, 3 not finite, 4 given way to harder
goals or the rest, 5 goals that contradict each other, 6 a method without headway),
iterations and descents ``(B, 3)``; time of each ``(B,)``.)");

  m.def("linearize_ik", &linearize_ik, "nodes"_a, "numbers"_a, "goals"_a, "goal_numbers"_a,
        "starts"_a, "targets"_a, "steps"_a,
        R"(Take steps ``(B, D)`` and look at the cost there, arrays as for `solve_ik`.

Returns ``(coordinates, residuals, Jacobians, curvatures)``: ``(B, Q)``; what is missing,
weighted ``(B, M)``; minus its derivatives ``(B, M, D)``; and the Hessian of half the
squared residual there, times the step ``(B, D)``.)");

  m.def("smooth_ik", &smooth_ik, "nodes"_a, "numbers"_a, "goals"_a, "goal_numbers"_a, "path"_a,
        "targets"_a, "sought"_a, "stretches"_a, "drifts"_a, "anchor"_a, "speed"_a, "acceleration"_a, "first"_a, "end"_a,
        "length_tolerance"_a, "angle_tolerance"_a, "damping"_a, "rounds"_a,
        R"(Make a path ``(F, Q)`` of one chain smoother, arrays as for `solve_ik`.

Frames from ``first`` to ``end`` move, in at most ``rounds`` steps of all at once, so that
``anchor |q - path|^2 + speed |v|^2 + acceleration |a|^2`` summed over the frames goes
down: v is the motion to the next frame less ``drifts`` ``(F - 1, D)``, a its change.
Goals that are reached stay so; where one is missed, all stay where the frame has them.

Returns ``(coordinates, misses, rounds, before, after)``: ``(F, Q)``, ``(F, E, K)``, steps
taken, and half the sum before and after them.)");

  m.def("fit_ik", &fit_ik, "nodes"_a, "numbers"_a, "goals"_a, "goal_numbers"_a, "path"_a,
        "targets"_a, "starts"_a, "anchor"_a, "speed"_a, "acceleration"_a, "robust"_a, "rest_weight"_a,
        "homing"_a, "first"_a, "end"_a, "iterations"_a, "rounds"_a, "tracked"_a,
        R"(Fit a path ``(F, Q)`` of one chain to goals by weight, arrays as for `solve_ik`.

Frames from ``first`` to ``end`` move. If ``tracked``, each is first looked for from where
those before it lead to, which draws it with ``rest_weight``; joints without a goal go the
share ``homing`` of the way to their rest. Where too little fits, it is looked for from
``starts`` ``(F, Q)``; goals whose positions were mixed up exchange them. Then, in at most ``rounds`` steps of all at once, the sum over the frames of
``r^2 / (1 + r^2 / robust^2)`` of each goal's weighted miss r and of
``anchor |q - tracked|^2 + speed |v|^2 + acceleration |a|^2`` is brought down.

Returns ``(coordinates, misses, searched, taken, rounds, before, after)``: ``(F, Q)``;
``(F, E, K)``; which frames begin at a start of their own ``(F,)``; whose target each goal has
``(F, E)``, -1 for none; steps taken, and half the sum before and after them.)");

  m.def("cheapest_ik_path", &cheapest_ik_path, "nodes"_a, "numbers"_a, "paths"_a, "costs"_a,
        "drifts"_a, "easy"_a, "open"_a, "closed"_a,
        R"(Which of K paths ``(K, L, Q)`` of a chain to be on in each frame ``(L,)``.

The way begins on the first path, unless ``open``, and ends there if ``closed``; the sum of
the squared steps from frame to frame, less ``drifts`` ``(L - 1, D)``, and of ``costs`` ``(K, L)`` is
the least. Joints that go farther than ``easy`` ``(L - 1,)`` cost a hundred times more.)");

  nb::class_<SpringNetwork>(m, "SpringNetwork",
                            R"(Particles, springs between them and what acts on them.

Inverse masses ``(N,)`` of particles that are held are 0; ``drags``
``(N,)`` slow them, a second. Springs join ``ends`` ``(S, 2)``; ``limit`` is the length at
which they tear. ``air_drag`` and ``air_lift`` of the air on ``triangles`` ``(T, 3)`` are over
the area and the square of the speed. Over the times of ``knots`` ``(K,)``: where ``held``
particles are ``(K or 1, P, 3)``; the points ``(K or 1, A, 3)`` that ``anchors`` are drawn to;
the wind ``(K or 1, 1, 3)``.)")
      .def(nb::init<In<double, 1>, In<double, 1>, In<std::int64_t, 2>, In<double, 1>,
                    In<double, 1>, In<double, 1>, In<double, 1>, In<std::int64_t, 2>,
                    In<double, 1>, double, double, In<double, 1>, In<std::int64_t, 1>,
                    In<double, 3>, In<std::int64_t, 1>, In<double, 1>, In<double, 1>,
                    In<double, 3>, In<double, 3>>(),
           "inverse_masses"_a, "drags"_a, "ends"_a, "rest"_a, "stiffness"_a, "damping"_a,
           "limit"_a, "triangles"_a, "gravity"_a, "air_drag"_a, "air_lift"_a, "knots"_a,
           "held"_a, "held_path"_a, "anchors"_a, "anchor_stiffness"_a, "anchor_damping"_a,
           "anchor_path"_a, "winds"_a)
      .def("lead", &SpringNetwork::lead, "held_path"_a, "anchor_path"_a,
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

  m.def("part_springs", &part_springs, "network"_a, "layers"_a, "before"_a, "after"_a, "h"_a,
        R"(Take the step of h that a surface is kept apart in from itself.

From positions ``(N, 3)`` to the state ``(2, N, 3)`` returned, of one that knows nothing.)");

  m.def("pierced_edges", &pierced_edges, "positions"_a, "triangles"_a,
        R"(How many edges go through triangles ``(T, 3)`` that have neither of their ends.

Each pair counts; at ``positions`` ``(N, 3)``.)");

  m.def("spring_order", &spring_order, "ends"_a, "particles"_a,
        R"(The order ``(S,)`` in which springs ``(S, 2)`` are gone through.

It is that of their particles, but for springs that do not wait for each other: these stand
together, so that several are done at once.)");

  m.def("spring_accelerations", &spring_accelerations, "network"_a, "t"_a, "h"_a, "state"_a,
        "torn"_a,
        R"(Accelerations ``(N, 3)`` at positions and velocities ``(2, N, 3)`` and a time.

Held particles have none; springs that are ``torn`` ``(S,)`` pull nothing. Speeds of what
anchors are drawn to are those of the h before.)");

  m.def("spring_energy", &spring_energy, "network"_a, "positions"_a,
        R"(Energy of springs at positions ``(N, 3)``, and their largest length.

Returns ``(energy, longest)``: of those with a length at rest, over that; 0 where there are
none.)");

  m.def("step_springs", &step_springs, "network"_a, "state"_a, "torn"_a, "origin"_a, "first"_a,
        "cell"_a, "cells"_a, "substeps"_a, "colliders"_a.none(),
        R"(Take semi-implicit Euler steps from a state ``(2, N, 3)``.

Cell i of time begins at ``origin + (first + i) cell`` and is that many substeps.

``colliders``: those of `collide_particles`, their poses at both ends of each cell
``(cells, C, 2, 7)``, the distance that particles keep, how deep each may be in each ``(C, N)``,
0 or less, None is not at all, how much deeper counts as left inside, and meshes whose points
move: a `MeshSurface`, its points at knots of time ``(K, P, 3)``, restitution, friction, margin,
depenetration speed and the speed of what is put elsewhere ``(5,)``, how many cells a knot
lasts, and how many cells of the first are over.

Returns ``(state, torn, unresolved)``: particles left inside colliders at the end.)");

  m.def("project_springs", &project_springs, "network"_a, "state"_a, "torn"_a, "origin"_a,
        "first"_a, "cell"_a, "cells"_a, "substeps"_a, "calm"_a, "least"_a, "most"_a,
        "stretch"_a, "colliders"_a.none(), "layers"_a.none(), "crossed"_a,
        R"(Take steps of extended position based dynamics, each spring once a step, in order.

Cells are those of `step_springs`. One at whose end a spring is longer than at rest by more
than this ``stretch``, and not mostly by its own give, is crossed again in twice the steps,
up to ``most``; after many that go well half as many are tried, down to ``least``.

``layers`` keep the surface apart from itself; ``crossed`` ``(C, 3)`` are passages to go on
with: a particle, the triangle that it went through, and the side of this that it came from;
or an edge, numbered after the particles, another of a higher number, and its side.

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

  m.def("follow_strands", &follow_strands, "strands"_a, "targets"_a, "state"_a, "span"_a,
        "substeps"_a, "colliders"_a.none(), "threads"_a = 1,
        R"(Take strands over a frame, from a state ``(2, N, 3)``.

The animation has their particles at ``targets`` ``(cells + 1, N, 3)`` as each even cell of the
time begins and ends, straight between them; roots are there. Steps are those of
`project_springs`, but for the springs along strands, which are solved together. ``colliders``
are those of `step_springs`. How many ``threads`` share the strands makes no difference.

Returns ``(state, touched, unresolved, stretch)``: particles in contact in a step, at most; left
inside at the end; how much longer than at rest a spring along them is there, over that.)");

  m.def("solve_springs", &solve_springs, "network"_a, "state"_a, "before"_a.none(), "torn"_a,
        "origin"_a, "first"_a, "cell"_a, "cells"_a, "substeps"_a, "two_steps"_a,
        "tolerance"_a, "colliders"_a.none(),
        R"(Take implicit steps: of Euler, or backward differences of ``two_steps``.

Cells are those of `step_springs`; ``before`` is the state a step before, None at the
start. Newton's method goes on until a correction moves no particle by more than
``tolerance``; a cell that is not solved is tried in shorter steps.

Returns ``(state, before, known, torn, steps, corrections, lost, unresolved)``: whether ``before`` is
known; steps and corrections taken; whether a cell could not be solved.)");

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

  m.def("step_rigid", &step_rigid, "bodies"_a, "state"_a, "pairs"_a, "contacts"_a, "held"_a,
        "forces"_a, "colliders"_a, "anchors"_a, "step"_a, "method"_a, "substeps"_a, "rounds"_a,
        "tolerance"_a, "drowsy"_a, "rest"_a,
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
