// Python bindings of capture.
#include "capture/capture.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_capture(nb::module_& m) {
  m.def("parse_bvh_rows", &parse_bvh_rows, Unlocked(), "text"_a, "columns"_a, "limit"_a, "final"_a,
        R"(Read rows of numbers from the text of a BVH MOTION block.

Reads complete lines until ``limit`` rows are read, a line is faulty, or the rest
of the text is not a complete line (``final``: the text ends with the file). Blank
lines are skipped. CR, LF and CR LF each end a line.

Returns ``(values, row_lines, consumed, lines, fault, count, token)``: float64
``(F, C)``, NaN where the text has NaN or infinity and infinity where a number
overflows float64; the 0-based line of each row; bytes and lines read; the fault
of the next line (0 none, 1 wrong count, 2 not a number), the count of numbers on
it and the word that is not a number.)");

  m.def("format_bvh_rows", &format_bvh_rows, Unlocked(), "values"_a, "decimals"_a,
        R"(Write float64 ``(F, C)`` as lines of decimal numbers, as bytes.

Column c is rounded to ``decimals[c]`` decimals (0 to 9), without trailing zeros.)");

  m.def("fit_face", &fit_face, Unlocked(), "neutral"_a, "deltas"_a, "observed"_a, "camera"_a.none(),
        "poses"_a, "weights"_a, "threshold"_a, "smooth"_a, "rest"_a, "tolerance"_a,
        "max_iterations"_a, "warm"_a,
        R"(Fit blend-shape weights and the head's pose to landmarks over frames.

Landmark n of a face is at ``R (neutral[n] + sum of w[s] deltas[s, n]) + t``; ``neutral``
``(1, N, 3)``, or ``(F, N, 3)`` with one a frame. ``observed`` is ``(F, N, 3)`` in that unit, or
with a ``camera`` fx, fy, cx, cy ``(F, N, 2)`` in pixels, in front of it along +Z; NaN is missing. ``poses`` ``(F, 7)``, quaternions x y z w and t, and
``weights`` ``(F, S)`` are where it starts. Weights stay between 0 and 1, their differences
from frame to frame cost ``smooth`` times the square, and they themselves ``rest``; a residual
beyond the ``threshold`` counts for less.

Returns ``(weights, poses, residuals, shares, rounds, change)``: lengths of the residuals
``(F, N)``, NaN where missing, and for how much each counted, 0 to 1; the largest change of a
weight in the last iteration. Iterations end where it is below ten times ``tolerance``. A ``warm`` start is
near the solution: outliers are known at once.)");

  m.def("triangulate_points", &triangulate_points, Unlocked(), "pixels"_a, "confidences"_a.none(),
        "cameras"_a, "active"_a, "noise"_a, "gate"_a, "condition"_a, "detailed"_a,
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

  m.def("least_median_residuals", &least_median_residuals, Unlocked(), "pixels"_a, "cameras"_a,
        R"(Return the least median of residuals over all pairs of cameras ``(F, M)`` [px].

NaN where fewer than three see a point. Arguments are those of `triangulate_points`.)");
}

}  // namespace animtool
