// Python bindings of curves.
#include "curves/curves.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_curves(nb::module_& m) {
  m.def("evaluate_curves", &evaluate_curves, WithoutLock(), "first"_a, "times"_a, "values"_a,
        "kinds"_a, "ins"_a, "outs"_a, "at"_a, "out"_a.noconvert() = nb::none(),
        R"(Evaluate C curves with K keys in total, as ``(C, F)``, constant outside their keys.

Curve c has the keys ``first[c]`` to ``first[c + 1]``, times ascending. ``kinds`` is
0 hold, 1 linear, 2 cubic, 3 Bezier. ``ins`` and ``outs`` are handles ``(K, 2)``: time
and value from the key. ``at`` is ``(1, F)``, or ``(C, F)`` with times per curve;
evaluation is fastest if times ascend, and if neighbouring curves have keys at the same times.
Numbers are finite; handles are checked if a segment uses them. Returns nothing if the result
is stored in ``out``.)");

  m.def("evaluate_rotations", &evaluate_rotations, WithoutLock(), "times"_a, "keys"_a, "kinds"_a,
        "at"_a, "times_beyond"_a, "cycle_counts"_a,
        R"(Evaluate C rotation curves with keys ``(K, C, 4)`` at the same times ``(K,)``.

``kinds`` of the segment after each key: 0 step, 1 slerp, 2 squad, 3 spline. ``at`` ``(F,)``
are between the first and last key. ``times_beyond`` ``(F,)`` is the time before (negative) or after
them, in which the curve continues to rotate. ``cycle_counts`` ``(F,)`` is how many times the change
from the first key to the last is added. Evaluation is fastest if times ascend. Numbers are
finite, and keys are not zero.

Returns quaternions ``(F, C, 4)``, with the signs nearest to the previous frame.)");

  m.def("rotation_steps", &rotation_steps, WithoutLock(), "rotations"_a,
        R"(Shortest rotation vectors ``(F - 1, C, 3)`` from frame to frame, in body space.)");

  m.def(
      "slerp", &slerp, WithoutLock(), "starts"_a, "ends"_a, "fractions"_a,
      R"(Interpolate shortest arcs between quaternions ``(N or 1, 4)`` at ``fractions`` ``(N,)``.)");

  m.def("fit_cubics", &fit_cubics, WithoutLock(), "values"_a, "bounds"_a, "anchors"_a, "low"_a,
        "high"_a, "straight_frames"_a,
        R"(Keys of cubic segments through samples ``(F, D)``, as few as a greedy search finds.

The Euclidean error at sample i is at most ``bounds[i]``. There is a key on each
of the frames ``anchors``, which ascend and exclude the first and last frame. No component
leaves the range from ``low`` to ``high`` ``(D,)`` between samples inside it. From each of the
``straight_frames`` a straight segment leads to the next frame. Handles lie at
thirds of a segment in time.

Values are finite, bounds above 0.

Returns ``(frames, ins, outs)``: int64 ``(K,)``, and the offsets of the control
values before and after each key ``(K, D)``. There is one key if all samples are within
their bounds of the first.)");

  m.def(
      "fitting_spans", &fitting_spans, WithoutLock(), "joint_rotations"_a, "parents"_a,
      "pose_indices"_a, "positions"_a, "pre_rotations"_a, "rest_rotations"_a, "feet"_a,
      "foot_stands"_a, "span_starts"_a, "span_width"_a, "max_joint_error"_a, "max_foot_error"_a,
      "max_root_shift"_a,
      R"(Find spans of ``span_width`` frames that can be interpolated, among F poses ``(F, M, 4)``.

Joints form a tree. ``parents`` ``(S,)`` come before their children; -1 is no parent.
``pose_indices`` ``(S,)`` are the indices of their rotations among the M of a pose; for -1 it is that
in ``rest_rotations`` ``(S, 4)``. ``positions`` ``(S, 3)`` are relative to the parent, and
``pre_rotations`` ``(S, 4)`` are the rotations of their frames. Signs of rotations are continuous.
Between the ends of a span, joints rotate uniformly along the shortest arc. Then all joints are moved
by at most ``max_root_shift`` [m], so that the mean position of the ``feet`` that stand
(``foot_stands`` ``(F, 2)``) does not change. A span fits if then no joint is farther than
``max_joint_error`` [m] from its position, and no standing foot farther than ``max_foot_error``.

Returns ``(span_fits, root_shifts)``: whether the span fits for each of ``span_starts`` ``(B,)``, and
the displacements of the frames inside ``(B, span_width - 1, 3)``, zero if a span does not fit.)");
}

}  // namespace animtool
