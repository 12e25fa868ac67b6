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
        "at"_a, "beyond"_a, "cycles"_a,
        R"(Evaluate C rotation curves with keys ``(K, C, 4)`` at the same times ``(K,)``.

``kinds`` of the segment after each key: 0 step, 1 slerp, 2 squad, 3 spline. ``at`` ``(F,)``
are between the first and last key. ``beyond`` ``(F,)`` is the time before (negative) or after
them, in which the curve continues to rotate. ``cycles`` ``(F,)`` is how many times the change
from the first key to the last is added. Evaluation is fastest if times ascend. Numbers are
finite, and keys are not zero.

Returns quaternions ``(F, C, 4)``, with the signs nearest to the previous frame.)");

  m.def("rotation_steps", &rotation_steps, WithoutLock(), "rotations"_a,
        R"(Shortest rotation vectors ``(F - 1, C, 3)`` from frame to frame, in body space.)");

  m.def(
      "slerp", &slerp, WithoutLock(), "starts"_a, "ends"_a, "shares"_a,
      R"(Interpolate shortest arcs between quaternions ``(N or 1, 4)`` at fractions ``shares`` ``(N,)``.)");

  m.def("fit_cubics", &fit_cubics, WithoutLock(), "values"_a, "bounds"_a, "anchors"_a, "low"_a,
        "high"_a, "straight"_a,
        R"(Keys of cubic segments through samples ``(F, D)``, as few as a greedy search finds.

The Euclidean error at sample i is at most ``bounds[i]``. There is a key on each
of the frames ``anchors``, which ascend and exclude the first and last frame. No component
leaves the range from ``low`` to ``high`` ``(D,)`` between samples inside it. From each of the
frames ``straight`` a straight segment leads to the next frame. Handles lie at
thirds of a segment in time.

Values are finite, bounds above 0.

Returns ``(frames, ins, outs)``: int64 ``(K,)``, and the offsets of the control
values before and after each key ``(K, D)``. There is one key if all samples are within
their bounds of the first.)");

  m.def(
      "fitting_spans", &fitting_spans, WithoutLock(), "turns"_a, "parents"_a, "numbers"_a,
      "places"_a, "before"_a, "rest"_a, "feet"_a, "stands"_a, "begins"_a, "wide"_a, "near"_a,
      "standing"_a, "hips"_a,
      R"(Find spans of ``wide`` frames that can be interpolated, among F poses ``turns`` ``(F, M, 4)``.

Joints form a tree. ``parents`` ``(S,)`` come before their children; -1 is no parent.
``numbers`` ``(S,)`` are the indices of their rotations among the M of a pose; -1 is the rotation
``rest``. ``places`` ``(S, 3)`` are offsets from the parent, and ``before`` ``(S, 4)`` the
rotations of their frames. Signs of rotations are continuous. Between the ends of a span, joints
rotate uniformly along the shortest arc. Then all joints are moved by at most ``hips`` [m], so that
the mean position of the ``feet`` that stand (``stands`` ``(F, 2)``) does not change. A span fits if
then no joint is farther than ``near`` [m] from its position, and no standing foot farther than
``standing``.

Returns ``(fits, moved)``: whether the span fits for each of ``begins`` ``(B,)``, and the
displacements of the frames inside ``(B, wide - 1, 3)``, zero if a span does not fit.)");
}

}  // namespace animtool
