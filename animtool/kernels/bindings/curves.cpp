// Python bindings of curves.
#include "curves/curves.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_curves(nb::module_& m) {
  m.def("evaluate_curves", &evaluate_curves, Unlocked(), "first"_a, "times"_a, "values"_a,
        "kinds"_a, "ins"_a, "outs"_a, "at"_a, "out"_a.noconvert() = nb::none(),
        R"(Evaluate C curves with K keys in all, as ``(C, F)``, held outside their keys.

Curve c has the keys ``first[c]`` to ``first[c + 1]``, times ascending. ``kinds`` is
0 hold, 1 linear, 2 cubic, 3 Bezier. ``ins`` and ``outs`` are handles ``(K, 2)``: time
and value from the key. ``at`` is ``(1, F)``, or ``(C, F)`` with times per curve;
ascending times are the quickest, and neighbouring curves with keys at the same times.
Numbers are finite; handles are checked where a segment uses them. Returns nothing where
``out`` is there to be filled.)");

  m.def("evaluate_rotations", &evaluate_rotations, Unlocked(), "times"_a, "keys"_a, "kinds"_a,
        "at"_a, "beyond"_a, "cycles"_a,
        R"(Evaluate C rotation curves with keys ``(K, C, 4)`` at the same times ``(K,)``.

``kinds`` of the segment behind each key: 0 step, 1 slerp, 2 squad, 3 spline. ``at`` ``(F,)``
are within the keys; ``beyond`` ``(F,)`` is time before (negative) or behind them, over which
the curve turns on, ``cycles`` ``(F,)`` how many rises from the first key to the last come on
top. Ascending times are the quickest. Numbers are finite, keys no zeros.

Returns quaternions ``(F, C, 4)``, signs those nearest to the frame before.)");

  m.def("rotation_steps", &rotation_steps, Unlocked(), "rotations"_a,
        R"(Shortest rotation vectors ``(F - 1, C, 3)`` from frame to frame, in body space.)");

  m.def("slerp", &slerp, Unlocked(), "starts"_a, "ends"_a, "shares"_a,
        R"(Shortest arcs between quaternions ``(N or 1, 4)`` at shares ``(N,)``.)");

  m.def("fit_cubics", &fit_cubics, Unlocked(), "values"_a, "bounds"_a, "anchors"_a, "low"_a,
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

  m.def("fitting_spans", &fitting_spans, Unlocked(), "turns"_a, "parents"_a, "numbers"_a,
        "places"_a, "before"_a, "rest"_a, "feet"_a, "stands"_a, "begins"_a, "wide"_a, "near"_a,
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
}

}  // namespace animtool
