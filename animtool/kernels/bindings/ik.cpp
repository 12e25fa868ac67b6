// Python bindings of inverse kinematics.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "ik/rig_solver.h"
#include "ik/solve.h"

namespace animtool {

void bind_ik(nb::module_& m) {
  using P = IkProblems;
  using S = IkSmoothing;
  using F = IkFitting;
  // Goal kinds, which a test compares with Python's table: name, number of residuals, size of a
  // target, whether the error is a length, and whether cyclic coordinate descent supports it.
  m.attr("IK_GOAL_KINDS") = nb::tuple(nb::cast(ik_goal_kinds()));

  m.def("to_chain_targets", &to_chain_targets, Unlocked(), "targets"_a, "frames"_a, "length"_a,
        R"(Convert targets ``(B, E, W)`` to the units and frames of a chain, in place.

Lengths are divided by ``length``. Rotations are normalised, or the identity without length, and
transformed to the frames of nodes: ``frames`` ``(E, 4)`` are node_from_joint.)");

  define(m, "solve_ik", &solve_ik,
         R"(Solve B inverse kinematics problems of one chain.

``nodes`` ``(N, 4)``: kind (0 pin, 1 slide, 2 ball), parent, first coordinate, whether
that belongs to an earlier node. ``numbers`` ``(N, 18)``: rest rotation by rows, offset,
gain, shift, limits (low, high; of a ball two swings, twist low, high). A pin turns about
its z, a slide goes along it, a ball twists about it. ``goals`` ``(E, 4)``: node, root and
middle of its limb, or -1; level, of which 0 comes first. ``goal_numbers``
``(E, 9 + K)``: offset in two parts, of which the first is a bone of its limb, aim axis,
weights of the kinds. ``targets`` ``(B, E, W)``, to which errors refer, in the order of ``IK_GOAL_KINDS``:
position, quaternion, point to aim at, pole, and factors of the weights; ``reachable`` are the
same, or closer ones within reach. ``stretches`` ``(B, E)`` scale the bones of limbs. Lengths are
fractions of the chain's. ``warm`` starts each problem at the previous solution. ``method``: 0
damped least squares, 1 gradient descent, 2 Newton, 3 CCD, 4 FABRIK, without slides; only the
first supports levels, the last two ignore the rest preference.

Returns ``(coordinates, errors, reports, seconds)``: ``(B, Q)``; errors of goals ``(B, E, K)``;
status (0 reached, 1 nearest, 2 budget, 3 not finite, 4 softened for harder goals or the rest
preference, 5 conflicting goals, 6 stalled), iterations and descents ``(B, 3)``; time of each
problem ``(B,)``.)",
         Field{"nodes", &P::nodes}, Field{"numbers", &P::numbers}, Field{"goals", &P::goals},
         Field{"goal_numbers", &P::goal_numbers}, Field{"starts", &P::starts},
         Field{"targets", &P::targets}, Field{"reachable", &P::reachable},
         Field{"stretches", &P::stretches}, Field{"rests", &P::rests},
         Field{"rest_weight", &P::rest_weight}, Field{"length_tolerance", &P::length_tolerance},
         Field{"angle_tolerance", &P::angle_tolerance}, Field{"damping", &P::damping},
         Field{"iterations", &P::iterations}, Field{"restarts", &P::restarts},
         Field{"seed", &P::seed}, Field{"seconds", &P::seconds}, Field{"ordered", &P::ordered},
         Field{"warm", &P::warm}, Field{"method", &P::method});

  m.def("extend_ik_limbs", &extend_ik_limbs, Unlocked(), "limbs"_a, "limb_numbers"_a, "targets"_a,
        R"(Return targets ``(B, E, W)`` within the limbs' extension, arrays as for `solve_ik`.

``limbs`` ``(L,)`` are their goals; ``limb_numbers`` ``(L, 7)``: root, reach, growth of the reach
with the bones, fraction of the reach over which it is softened, and largest stretch of the bones.

Returns ``(reachable, scales, softened)``: these targets; scales of the bones ``(B, E)``; whether
softening alone keeps a goal from its target ``(B, E)``.)");

  m.def("arm_kind", &arm_kind, Unlocked(), "nodes"_a, "numbers"_a, "goals"_a, "goal_numbers"_a,
        "rest_weight"_a,
        R"(Return the closed form of a chain, arrays as for `solve_ik`.

0 none, 1 six pins of which the last three meet, 2 six of which the middle ones are parallel.)");

  using R = RigSolverArrays;
  nb::class_<RigSolver> rig_solver(m, "RigSolver",
                                   R"(Solver of problems of one rig, arrays as for `solve_ik`.

``goal_frames`` ``(E, 4)`` and ``length`` are those of `to_chain_targets`. The chain's
coordinates are ``columns`` ``(C,)`` of the rig's over ``scales``; periodic ones stay in
``periods`` ``(C, 2)``; from ``balls`` ``(T,)`` on they are quaternions in ``ball_frames``.
``mimics`` ``(M, 2)`` are columns and those of their leaders, ``mimic_numbers`` gain and offset.
``limbs`` and ``limb_numbers`` are those of `extend_ik_limbs`; ``limb_joints`` are joints of their
bones, and the goals. The others are those of `coordinates_to_local`.
``closed``: 0 none, 1 a limb of two bones, 2 an arm of six pins.)");
  define_class(rig_solver, Field{"nodes", &R::nodes}, Field{"numbers", &R::numbers},
               Field{"goals", &R::goals}, Field{"goal_numbers", &R::goal_numbers},
               Field{"rest_weight", &R::rest_weight}, Field{"goal_frames", &R::goal_frames},
               Field{"length", &R::length}, Field{"columns", &R::columns},
               Field{"scales", &R::scales}, Field{"periods", &R::periods},
               Field{"balls", &R::balls}, Field{"ball_frames", &R::ball_frames},
               Field{"mimics", &R::mimics}, Field{"mimic_numbers", &R::mimic_numbers},
               Field{"limbs", &R::limbs}, Field{"limb_numbers", &R::limb_numbers},
               Field{"limb_joints", &R::limb_joints}, Field{"parents", &R::parents},
               Field{"types", &R::types}, Field{"joint_columns", &R::joint_columns},
               Field{"axes", &R::axes}, Field{"rest_translations", &R::rest_translations},
               Field{"rest_rotations", &R::rest_rotations}, Field{"closed", &R::closed},
               Field{"length_tolerance", &R::length_tolerance},
               Field{"angle_tolerance", &R::angle_tolerance}, Field{"damping", &R::damping},
               Field{"iterations", &R::iterations}, Field{"restarts", &R::restarts},
               Field{"seed", &R::seed}, Field{"seconds", &R::seconds},
               Field{"ordered", &R::ordered}, Field{"warm", &R::warm}, Field{"method", &R::method});
  rig_solver
      .def("solve", &RigSolver::solve, Unlocked(), "starts"_a, "targets"_a, "preferred"_a.none(),
           "placed"_a,
           R"(Solve problems from poses ``(B, Q)`` and targets in the world ``(B, E, W)``.

``preferred`` ``(B, Q)``; None is the starts.

Returns ``(coordinates, errors, reports, seconds, reached, scales, positions, linear)``: the first
four are those of `solve_ik`, in the rig's units; whether goals are reached ``(B, E)``; scales of
the bones ``(B, E)``; if ``placed``, world positions ``(B, J, 3)`` and linear parts of the joints
``(B, J, 3, 3)``, else empty.)")
      .def(
          "branches", &RigSolver::branches, Unlocked(), "start"_a, "targets"_a,
          R"(Return all poses of an arm ``(N, Q)`` that reach targets ``(E, W)``, nearest first.)");

  m.def("linearize_ik", &linearize_ik, Unlocked(), "nodes"_a, "numbers"_a, "goals"_a,
        "goal_numbers"_a, "starts"_a, "targets"_a, "steps"_a,
        R"(Return costs after steps ``(B, D)``, arrays as for `solve_ik`.

Returns ``(coordinates, residuals, Jacobians, curvatures)``: ``(B, Q)``; weighted residuals
``(B, M)``; minus their derivatives ``(B, M, D)``; and the Hessian of half the squared residual,
times the step ``(B, D)``.)");

  define(m, "smooth_ik", &smooth_ik,
         R"(Smooth a path ``(F, Q)`` of one chain, arrays as for `solve_ik`.

Frames from ``first`` to ``end`` move, in at most ``rounds`` Gauss-Newton iterations over all of
them, which reduce the sum of ``anchor |q - path|^2 + speed |v|^2 + acceleration |a|^2``: v is the
motion to the next frame less ``drifts`` ``(F - 1, D)``, a its change. Reached goals stay reached;
in a frame that misses one, all goals keep their current values.

Returns ``(coordinates, errors, rounds, before, after)``: ``(F, Q)``, ``(F, E, K)``, iterations,
and half the sum before and after.)",
         Field{"nodes", &S::nodes}, Field{"numbers", &S::numbers}, Field{"goals", &S::goals},
         Field{"goal_numbers", &S::goal_numbers}, Field{"path", &S::path},
         Field{"targets", &S::targets}, Field{"reachable", &S::reachable},
         Field{"stretches", &S::stretches}, Field{"drifts", &S::drifts},
         Field{"anchor", &S::anchor}, Field{"speed", &S::speed},
         Field{"acceleration", &S::acceleration}, Field{"first", &S::first}, Field{"end", &S::end},
         Field{"length_tolerance", &S::length_tolerance},
         Field{"angle_tolerance", &S::angle_tolerance}, Field{"damping", &S::damping},
         Field{"rounds", &S::rounds});

  define(m, "fit_ik", &fit_ik,
         R"(Fit a path ``(F, Q)`` of one chain to weighted goals, arrays as for `solve_ik`.

Frames from ``first`` to ``end`` move. If ``tracked``, each is first solved from the pose that the
previous frames predict, which attracts it with ``rest_weight``; joints without a goal return by
the fraction ``homing`` towards their rest. If few goals fit, a frame is solved from ``starts``
``(F, Q)``; goals with swapped positions exchange them. Then at most ``rounds`` Gauss-Newton
iterations over all frames reduce the sum of ``r^2 / (1 + r^2 / robust^2)`` of the weighted error r
of each goal and of ``anchor |q - tracked|^2 + speed |v|^2 + acceleration |a|^2``.

Returns ``(coordinates, errors, searched, taken, rounds, before, after)``: ``(F, Q)``;
``(F, E, K)``; whether a frame was solved from its own start ``(F,)``; the target of each goal
``(F, E)``, -1 for none; iterations, and half the sum before and after.)",
         Field{"nodes", &F::nodes}, Field{"numbers", &F::numbers}, Field{"goals", &F::goals},
         Field{"goal_numbers", &F::goal_numbers}, Field{"path", &F::path},
         Field{"targets", &F::targets}, Field{"starts", &F::starts}, Field{"anchor", &F::anchor},
         Field{"speed", &F::speed}, Field{"acceleration", &F::acceleration},
         Field{"robust", &F::robust}, Field{"rest_weight", &F::rest_weight},
         Field{"homing", &F::homing}, Field{"first", &F::first}, Field{"end", &F::end},
         Field{"iterations", &F::iterations}, Field{"rounds", &F::rounds},
         Field{"tracked", &F::tracked});

  m.def("cheapest_ik_path", &cheapest_ik_path, Unlocked(), "nodes"_a, "numbers"_a, "paths"_a,
        "costs"_a, "drifts"_a, "easy"_a, "open"_a, "closed"_a,
        R"(Return the path to follow at each frame ``(L,)`` among K paths ``(K, L, Q)``.

The way begins on the first path, unless ``open``, and ends there if ``closed``; the sum of
the squared steps from frame to frame, less ``drifts`` ``(L - 1, D)``, and of ``costs`` ``(K, L)`` is
the least. Joints that go farther than ``easy`` ``(L - 1,)`` cost a hundred times more.)");
}

}  // namespace animtool
