// Python bindings of crowds and flocks.
#include "crowds/crowds.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_crowds(nb::module_& m) {
  using Step = CrowdStep;
  m.def("flock_accelerations", &flock_accelerations, WithoutLock(), "points"_a, "velocities"_a,
        "members"_a.none(), "others"_a.none(), "radius"_a, "cosine"_a, "nearest"_a, "attraction"_a,
        "alignment"_a, "repulsion"_a, "softening"_a, "period"_a, "max_tests"_a,
        R"(Accelerations of M flock members from others in sight ``(M, 3)`` [m/s²].

``members`` and ``others`` index ``points`` ``(N, 3)``; None is all. A member sees others within
``radius`` and an angle about its velocity with this ``cosine`` (-1 is all around), of these the
``nearest`` (0 is all). ``attraction`` is towards their centre, ``alignment`` to their mean
velocity, and ``repulsion`` away from each: pairs of a weight and a radius. ``period`` is the
origin and length of each axis ``(2, 3)``, length 0 if not periodic.

Returns ``(accelerations, counts, pairs)``: numbers of visible others ``(M,)``, and the number of
tested pairs; if that exceeds ``max_tests``, the result is incomplete.)");

  m.def("flock_braking", &flock_braking, WithoutLock(), "points"_a, "velocities"_a,
        "min_distances"_a, "sight"_a, "min_gap"_a, "period"_a, "max_tests"_a,
        R"(Braking accelerations of N members ahead of others ``(N, 3)`` [m/s²].

The minimum distance of a pair is the mean of their ``min_distances`` ``(N,)`` [m], 0 for none. Within
``sight`` times that each takes half of their squared closing speed over twice the remaining gap,
weighted by proximity; the gap is at least ``min_gap`` times the distance. ``period`` is as in
`flock_accelerations`.

Returns ``(accelerations, pairs)``: the number of tested pairs; if it exceeds ``max_tests``, the result
is incomplete.)");

  m.def(
      "flock_separate", &flock_separate, WithoutLock(), "points"_a, "min_distances"_a,
      "max_passes"_a, "relaxation"_a, "clearance"_a, "period"_a, "max_tests"_a,
      R"(Separate N members that are closer than the mean of their ``min_distances`` ``(N, 3)`` [m].

Each of at most ``max_passes`` passes moves them by ``relaxation`` of the missing distance, plus ``clearance``
times the minimum. ``period`` is as in `flock_accelerations`.

Returns ``(points, overlap, pairs)``: the remaining overlap [m], and the number of tested pairs;
if that exceeds ``max_tests``, the result is incomplete.)");

  define(m, "crowd_step", &crowd_step,
         R"(Positions of N agents after a step [s] ``(N, 2)`` [m], and their velocities.

Agents prefer ``preferred`` ``(N, 2)`` [m/s], slower if an agent ahead with the same direction is
less than ``headway`` [s] away, and move away at ``push`` [m/s] from others nearer than ``space``
[m] outside their group (-1 is none). Against oncoming or crossing agents they take the cheapest
lane; each lane farther to the left costs less by ``side``, -1 to 1. Speeds are at most ``max_speeds``;
collisions with the ``nearest`` agents within ``sight`` [m] are avoided for ``horizon`` [s], or as
far as possible. ``modes`` is 0 for walking, 1 for staying and 2 for absent agents. ``walls``
``(M, 4)``, from ``starts`` of each agent on: a unit normal, the least velocity along it, and the
least position along it. Then overlapping agents are separated, in proportion to ``yielding``, in at
most ``max_passes`` passes, until the largest overlap is ``tolerance`` [m].

``shoulders`` ``(N, 2)`` are along the shoulder lines: length 0 is a disc, 1 an ellipse with
``depth`` times the depth of its width.

Returns ``(points, velocities, overlap, pressed)``: target shoulder yaws, positive for others on
the left and negative on the right, -1 to 1 ``(N,)``.)",
         Field{"points", &Step::points}, Field{"velocities", &Step::velocities},
         Field{"preferred", &Step::preferred}, Field{"radii", &Step::radii},
         Field{"max_speeds", &Step::max_speeds}, Field{"yielding", &Step::yielding},
         Field{"shoulders", &Step::shoulders}, Field{"depth", &Step::depth},
         Field{"groups", &Step::groups}, Field{"modes", &Step::modes},
         Field{"starts", &Step::starts}, Field{"walls", &Step::walls}, Field{"sight", &Step::sight},
         Field{"nearest", &Step::nearest}, Field{"horizon", &Step::horizon},
         Field{"space", &Step::space}, Field{"push", &Step::push}, Field{"headway", &Step::headway},
         Field{"side", &Step::side}, Field{"step", &Step::step},
         Field{"max_passes", &Step::max_passes}, Field{"tolerance", &Step::tolerance});

  m.def(
      "travel_distances", &travel_distances, WithoutLock(), "is_free"_a, "cell_size"_a, "seeds"_a,
      "starts"_a,
      R"(Distances of grid nodes from seeds along free nodes ``(R, C)`` [m]; infinite if unreachable.

``seeds`` are node numbers, and ``starts`` are their initial distances.)");
}

}  // namespace animtool
