// Python bindings of crowds and flocks.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "crowds/crowds.h"

namespace animtool {

void bind_crowds(nb::module_& m) {
  using S = CrowdStep;
  m.def("flock_accelerations", &flock_accelerations, Unlocked(), "points"_a, "velocities"_a,
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

  m.def("flock_braking", &flock_braking, Unlocked(), "points"_a, "velocities"_a, "least"_a, "seen"_a,
        "room"_a, "period"_a, "most"_a,
        R"(What stops N members before they are nearer than they may be ``(N, 3)`` [m/s²].

Two are as far apart as the mean of their ``least`` ``(N,)`` [m], 0 of who keeps none. Within
``seen`` times that each takes half of the square of their speed over twice what is left of it,
the more the nearer they are; this is no less than ``room`` of their distance. ``period`` is as
in `flock_accelerations`.

Returns ``(accelerations, pairs)``: how many pairs there were to look at; where these are more
than ``most``, not all are done.)");

  m.def("flock_apart", &flock_apart, Unlocked(), "points"_a, "least"_a, "rounds"_a, "share"_a, "clear"_a,
        "period"_a, "most"_a,
        R"(Move N members apart that are nearer than the mean of their ``least`` ``(N, 3)`` [m].

In each of ``rounds``, at most, they are moved by ``share`` of what lacks and of ``clear`` times
their distance more. ``period`` is as in `flock_accelerations`.

Returns ``(points, overlap, pairs)``: what is left in each other [m], and how many pairs there
were to look at; where these are more than ``most``, it stops.)");

  define(m, "crowd_step", &crowd_step,
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

``shoulders`` ``(N, 2)`` are along the lines of shoulders that are turned: 0 long is a disc, 1
an ellipse that is ``depth`` times as thick as it is wide.

Returns ``(points, velocities, overlap, pressed)``: how far each is to turn its shoulders, to
who is on its left, or below 0 on its right, -1 to 1 ``(N,)``.)",
         Field{"points", &S::points}, Field{"velocities", &S::velocities},
         Field{"preferred", &S::preferred}, Field{"radii", &S::radii}, Field{"most", &S::most},
         Field{"gives", &S::gives}, Field{"shoulders", &S::shoulders}, Field{"depth", &S::depth},
         Field{"groups", &S::groups}, Field{"does", &S::does}, Field{"starts", &S::starts},
         Field{"walls", &S::walls}, Field{"sight", &S::sight}, Field{"nearest", &S::nearest},
         Field{"horizon", &S::horizon}, Field{"space", &S::space}, Field{"push", &S::push},
         Field{"headway", &S::headway}, Field{"side", &S::side}, Field{"step", &S::step},
         Field{"rounds", &S::rounds}, Field{"enough", &S::enough});

  m.def("travel_distances", &travel_distances, Unlocked(), "free"_a, "cell"_a, "seeds"_a,
        "starts"_a,
        R"(How far nodes of a grid are from seeds on ways over free nodes alone ``(R, C)`` [m].

Infinite where no way leads. ``seeds`` are numbers of nodes, and ``starts`` how far these are
from where the ways end.)");
}

}  // namespace animtool
