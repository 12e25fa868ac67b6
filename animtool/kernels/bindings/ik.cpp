// Python bindings of inverse kinematics.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "ik/rig_solver.h"
#include "ik/solve.h"

namespace animtool {

void bind_ik(nb::module_& m) {
  using Problems = IkProblems;
  using Smoothing = IkSmoothArguments;
  using Fitting = IkFitArguments;
  // The kinds of goals, which a test compares with Python's table: name, number of residuals, size
  // of a target, whether the error is a length, and whether cyclic coordinate descent supports it.
  m.attr("IK_GOAL_KINDS") = nb::tuple(nb::cast(ik_goal_kinds()));

  m.def("to_chain_targets", &to_chain_targets, WithoutLock(), "targets"_a, "frames"_a, "length"_a,
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
first supports levels. The last two ignore the rest preference.

Returns ``(coordinates, errors, reports, seconds)``: ``(B, Q)``; errors of goals ``(B, E, K)``;
status (0 reached, 1 nearest, 2 budget, 3 not finite, 4 softened for harder goals or the rest
preference, 5 conflicting goals, 6 stalled), iterations and descents ``(B, 3)``; time of each
problem ``(B,)``.)",
         Field{"nodes", &Problems::nodes}, Field{"numbers", &Problems::numbers},
         Field{"goals", &Problems::goals}, Field{"goal_numbers", &Problems::goal_numbers},
         Field{"starts", &Problems::starts}, Field{"targets", &Problems::targets},
         Field{"reachable", &Problems::reachable}, Field{"stretches", &Problems::stretches},
         Field{"rests", &Problems::rests}, Field{"rest_weight", &Problems::rest_weight},
         Field{"length_tolerance", &Problems::length_tolerance},
         Field{"angle_tolerance", &Problems::angle_tolerance}, Field{"damping", &Problems::damping},
         Field{"iterations", &Problems::iterations}, Field{"restarts", &Problems::restarts},
         Field{"seed", &Problems::seed}, Field{"seconds", &Problems::seconds},
         Field{"ordered", &Problems::ordered}, Field{"warm", &Problems::warm},
         Field{"method", &Problems::method});

  m.def("extend_ik_limbs", &extend_ik_limbs, WithoutLock(), "limbs"_a, "limb_numbers"_a,
        "targets"_a,
        R"(Return targets ``(B, E, W)`` within the limbs' extension, arrays as for `solve_ik`.

``limbs`` ``(L,)`` are the indices of their goals. ``limb_numbers`` ``(L, 7)``: root, reach, growth
of the reach with the bones, fraction of the reach over which it is softened, and largest stretch of the bones.

Returns ``(reachable, scales, softened)``: these targets; scales of the bones ``(B, E)``; whether
softening alone keeps a goal from its target ``(B, E)``.)");

  m.def("arm_kind", &arm_kind, WithoutLock(), "nodes"_a, "numbers"_a, "goals"_a, "goal_numbers"_a,
        "rest_weight"_a,
        R"(Return the closed form of a chain, arrays as for `solve_ik`.

0 none, 1 six pins of which the last three meet, 2 six of which the middle ones are parallel.)");

  using Solver = RigSolverArrays;
  nb::class_<RigSolver> rig_solver(m, "RigSolver",
                                   R"(Solver of problems of one rig, arrays as for `solve_ik`.

``goal_frames`` ``(E, 4)`` and ``length`` are those of `to_chain_targets`. The chain's
coordinates are ``columns`` ``(C,)`` of the rig's over ``scales``; periodic ones stay in
``periods`` ``(C, 2)``; from ``balls`` ``(T,)`` on they are quaternions in ``ball_frames``.
``mimics`` ``(M, 2)`` are columns and those of their leaders, ``mimic_numbers`` gain and offset.
``limbs`` and ``limb_numbers`` are those of `extend_ik_limbs`; ``limb_joints`` are joints of their
bones, and the goals. The others are those of `coordinates_to_local`.
``closed``: 0 none, 1 a limb of two bones, 2 an arm of six pins.)");
  define_class(rig_solver, Field{"nodes", &Solver::nodes}, Field{"numbers", &Solver::numbers},
               Field{"goals", &Solver::goals}, Field{"goal_numbers", &Solver::goal_numbers},
               Field{"rest_weight", &Solver::rest_weight},
               Field{"goal_frames", &Solver::goal_frames}, Field{"length", &Solver::length},
               Field{"columns", &Solver::columns}, Field{"scales", &Solver::scales},
               Field{"periods", &Solver::periods}, Field{"balls", &Solver::balls},
               Field{"ball_frames", &Solver::ball_frames}, Field{"mimics", &Solver::mimics},
               Field{"mimic_numbers", &Solver::mimic_numbers}, Field{"limbs", &Solver::limbs},
               Field{"limb_numbers", &Solver::limb_numbers},
               Field{"limb_joints", &Solver::limb_joints}, Field{"parents", &Solver::parents},
               Field{"types", &Solver::types}, Field{"joint_columns", &Solver::joint_columns},
               Field{"axes", &Solver::axes}, Field{"rest_translations", &Solver::rest_translations},
               Field{"rest_rotations", &Solver::rest_rotations}, Field{"closed", &Solver::closed},
               Field{"length_tolerance", &Solver::length_tolerance},
               Field{"angle_tolerance", &Solver::angle_tolerance},
               Field{"damping", &Solver::damping}, Field{"iterations", &Solver::iterations},
               Field{"restarts", &Solver::restarts}, Field{"seed", &Solver::seed},
               Field{"seconds", &Solver::seconds}, Field{"ordered", &Solver::ordered},
               Field{"warm", &Solver::warm}, Field{"method", &Solver::method});
  rig_solver
      .def("solve", &RigSolver::solve, WithoutLock(), "starts"_a, "targets"_a, "preferred"_a.none(),
           "returns_joint_poses"_a,
           R"(Solve problems from poses ``(B, Q)`` and targets in the world ``(B, E, W)``.

``preferred`` ``(B, Q)``; None is the starts.

Returns ``(coordinates, errors, reports, seconds, reached, scales, positions, linear)``: the first
four are those of `solve_ik`, in the rig's units; whether goals are reached ``(B, E)``; scales of
the bones ``(B, E)``; if ``returns_joint_poses``, world positions ``(B, J, 3)`` and linear parts of the joints
``(B, J, 3, 3)``, else empty.)")
      .def(
          "branches", &RigSolver::branches, WithoutLock(), "start"_a, "targets"_a,
          R"(Return all poses of an arm ``(N, Q)`` that reach targets ``(E, W)``, nearest first.)");

  m.def("linearize_ik", &linearize_ik, WithoutLock(), "nodes"_a, "numbers"_a, "goals"_a,
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
         Field{"nodes", &Smoothing::nodes}, Field{"numbers", &Smoothing::numbers},
         Field{"goals", &Smoothing::goals}, Field{"goal_numbers", &Smoothing::goal_numbers},
         Field{"path", &Smoothing::path}, Field{"targets", &Smoothing::targets},
         Field{"reachable", &Smoothing::reachable}, Field{"stretches", &Smoothing::stretches},
         Field{"drifts", &Smoothing::drifts}, Field{"anchor", &Smoothing::anchor},
         Field{"speed", &Smoothing::speed}, Field{"acceleration", &Smoothing::acceleration},
         Field{"first", &Smoothing::first}, Field{"end", &Smoothing::end},
         Field{"length_tolerance", &Smoothing::length_tolerance},
         Field{"angle_tolerance", &Smoothing::angle_tolerance},
         Field{"damping", &Smoothing::damping}, Field{"rounds", &Smoothing::rounds});

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
         Field{"nodes", &Fitting::nodes}, Field{"numbers", &Fitting::numbers},
         Field{"goals", &Fitting::goals}, Field{"goal_numbers", &Fitting::goal_numbers},
         Field{"path", &Fitting::path}, Field{"targets", &Fitting::targets},
         Field{"starts", &Fitting::starts}, Field{"anchor", &Fitting::anchor},
         Field{"speed", &Fitting::speed}, Field{"acceleration", &Fitting::acceleration},
         Field{"robust", &Fitting::robust}, Field{"rest_weight", &Fitting::rest_weight},
         Field{"homing", &Fitting::homing}, Field{"first", &Fitting::first},
         Field{"end", &Fitting::end}, Field{"iterations", &Fitting::iterations},
         Field{"rounds", &Fitting::rounds}, Field{"tracked", &Fitting::tracked});

  m.def("cheapest_ik_path", &cheapest_ik_path, WithoutLock(), "nodes"_a, "numbers"_a, "paths"_a,
        "costs"_a, "drifts"_a, "free_step"_a, "allows_any_start"_a, "must_end_on_first"_a,
        R"(Return the path to follow at each frame ``(L,)`` among K paths ``(K, L, Q)``.

The result begins on the first path, unless ``allows_any_start``, and ends there if ``must_end_on_first``. It minimises
the sum of ``costs`` ``(K, L)`` and of the squared steps from frame to frame, minus ``drifts``
``(L - 1, D)``. Joints that move farther than ``free_step`` ``(L - 1,)`` cost a hundred times more.)");
}

}  // namespace animtool
