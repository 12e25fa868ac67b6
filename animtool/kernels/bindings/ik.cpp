// Python bindings of inverse kinematics.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "ik/solve.h"

namespace animtool {

void bind_ik(nb::module_& m) {
  // Of Python's table a test compares: name, residuals, width of a target, whether what it
  // misses is a length, and whether cyclic coordinate descent heeds it.
  m.attr("IK_GOAL_KINDS") = nb::tuple(nb::cast(ik_goal_kinds()));

  m.def("place_ik_targets", &place_ik_targets, Unlocked(), "targets"_a, "frames"_a, "length"_a,
        R"(Bring targets ``(B, E, W)`` to a chain, in place.

Lengths are divided by ``length``, rotations brought to length 1, one without length to
the identity, and seen from the nodes: ``frames`` ``(E, 4)`` are node_from_joint.)");

  define(m, "solve_ik", &solve_ik,
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
iterations and descents ``(B, 3)``; time of each ``(B,)``.)",
         Field{"nodes", &IkProblems::nodes}, Field{"numbers", &IkProblems::numbers},
         Field{"goals", &IkProblems::goals}, Field{"goal_numbers", &IkProblems::goal_numbers},
         Field{"starts", &IkProblems::starts}, Field{"targets", &IkProblems::targets},
         Field{"sought", &IkProblems::sought}, Field{"stretches", &IkProblems::stretches},
         Field{"rests", &IkProblems::rests}, Field{"rest_weight", &IkProblems::rest_weight},
         Field{"length_tolerance", &IkProblems::length_tolerance},
         Field{"angle_tolerance", &IkProblems::angle_tolerance},
         Field{"damping", &IkProblems::damping}, Field{"iterations", &IkProblems::iterations},
         Field{"restarts", &IkProblems::restarts}, Field{"seed", &IkProblems::seed},
         Field{"seconds", &IkProblems::seconds}, Field{"ordered", &IkProblems::ordered},
         Field{"warm", &IkProblems::warm}, Field{"method", &IkProblems::method});

  m.def("linearize_ik", &linearize_ik, Unlocked(), "nodes"_a, "numbers"_a, "goals"_a,
        "goal_numbers"_a, "starts"_a, "targets"_a, "steps"_a,
        R"(Take steps ``(B, D)`` and look at the cost there, arrays as for `solve_ik`.

Returns ``(coordinates, residuals, Jacobians, curvatures)``: ``(B, Q)``; what is missing,
weighted ``(B, M)``; minus its derivatives ``(B, M, D)``; and the Hessian of half the
squared residual there, times the step ``(B, D)``.)");

  define(m, "smooth_ik", &smooth_ik,
         R"(Make a path ``(F, Q)`` of one chain smoother, arrays as for `solve_ik`.

Frames from ``first`` to ``end`` move, in at most ``rounds`` steps of all at once, so that
``anchor |q - path|^2 + speed |v|^2 + acceleration |a|^2`` summed over the frames goes
down: v is the motion to the next frame less ``drifts`` ``(F - 1, D)``, a its change.
Goals that are reached stay so; where one is missed, all stay where the frame has them.

Returns ``(coordinates, misses, rounds, before, after)``: ``(F, Q)``, ``(F, E, K)``, steps
taken, and half the sum before and after them.)",
         Field{"nodes", &IkSmoothing::nodes}, Field{"numbers", &IkSmoothing::numbers},
         Field{"goals", &IkSmoothing::goals}, Field{"goal_numbers", &IkSmoothing::goal_numbers},
         Field{"path", &IkSmoothing::path}, Field{"targets", &IkSmoothing::targets},
         Field{"sought", &IkSmoothing::sought}, Field{"stretches", &IkSmoothing::stretches},
         Field{"drifts", &IkSmoothing::drifts}, Field{"anchor", &IkSmoothing::anchor},
         Field{"speed", &IkSmoothing::speed}, Field{"acceleration", &IkSmoothing::acceleration},
         Field{"first", &IkSmoothing::first}, Field{"end", &IkSmoothing::end},
         Field{"length_tolerance", &IkSmoothing::length_tolerance},
         Field{"angle_tolerance", &IkSmoothing::angle_tolerance},
         Field{"damping", &IkSmoothing::damping}, Field{"rounds", &IkSmoothing::rounds});

  define(m, "fit_ik", &fit_ik,
         R"(Fit a path ``(F, Q)`` of one chain to goals by weight, arrays as for `solve_ik`.

Frames from ``first`` to ``end`` move. If ``tracked``, each is first looked for from where
those before it lead to, which draws it with ``rest_weight``; joints without a goal go the
share ``homing`` of the way to their rest. Where too little fits, it is looked for from
``starts`` ``(F, Q)``; goals whose positions were mixed up exchange them. Then, in at most ``rounds`` steps of all at once, the sum over the frames of
``r^2 / (1 + r^2 / robust^2)`` of each goal's weighted miss r and of
``anchor |q - tracked|^2 + speed |v|^2 + acceleration |a|^2`` is brought down.

Returns ``(coordinates, misses, searched, taken, rounds, before, after)``: ``(F, Q)``;
``(F, E, K)``; which frames begin at a start of their own ``(F,)``; whose target each goal has
``(F, E)``, -1 for none; steps taken, and half the sum before and after them.)",
         Field{"nodes", &IkFitting::nodes}, Field{"numbers", &IkFitting::numbers},
         Field{"goals", &IkFitting::goals}, Field{"goal_numbers", &IkFitting::goal_numbers},
         Field{"path", &IkFitting::path}, Field{"targets", &IkFitting::targets},
         Field{"starts", &IkFitting::starts}, Field{"anchor", &IkFitting::anchor},
         Field{"speed", &IkFitting::speed}, Field{"acceleration", &IkFitting::acceleration},
         Field{"robust", &IkFitting::robust}, Field{"rest_weight", &IkFitting::rest_weight},
         Field{"homing", &IkFitting::homing}, Field{"first", &IkFitting::first},
         Field{"end", &IkFitting::end}, Field{"iterations", &IkFitting::iterations},
         Field{"rounds", &IkFitting::rounds}, Field{"tracked", &IkFitting::tracked});

  m.def("cheapest_ik_path", &cheapest_ik_path, Unlocked(), "nodes"_a, "numbers"_a, "paths"_a,
        "costs"_a, "drifts"_a, "easy"_a, "open"_a, "closed"_a,
        R"(Which of K paths ``(K, L, Q)`` of a chain to be on in each frame ``(L,)``.

The way begins on the first path, unless ``open``, and ends there if ``closed``; the sum of
the squared steps from frame to frame, less ``drifts`` ``(L - 1, D)``, and of ``costs`` ``(K, L)`` is
the least. Joints that go farther than ``easy`` ``(L - 1,)`` cost a hundred times more.)");
}

}  // namespace animtool
