// Python bindings of capture.
#include "capture/capture.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_capture(nb::module_& m) {
  m.def("parse_bvh_rows", &parse_bvh_rows, WithoutLock(), "text"_a, "columns"_a, "limit"_a,
        "is_final"_a,
        R"(Read rows of numbers from the text of a BVH MOTION block.

Reads complete lines until ``limit`` rows are read, a line is invalid, or the rest
of the text is not a complete line. With ``is_final``, the text ends with the file. Blank
lines are skipped. CR, LF and CR LF each end a line.

Returns ``(values, row_lines, consumed, lines, fault, count, token)``: float64
``(F, C)``, NaN for NaN or infinity in the text, and infinity for a number that
overflows float64; the line of each row, counted from 0; the numbers of bytes and lines
read; the fault of the next line (0 none, 1 wrong count, 2 not a number), the count of
numbers on it, and the word that is not a number.)");

  m.def("format_bvh_rows", &format_bvh_rows, WithoutLock(), "values"_a, "decimals"_a,
        R"(Write float64 ``(F, C)`` as lines of decimal numbers, as bytes.

Column c is rounded to ``decimals[c]`` decimals (0 to 9), without trailing zeros.)");

  m.def("fit_face", &fit_face, WithoutLock(), "neutral"_a, "deltas"_a, "observed"_a,
        "camera"_a.none(), "poses"_a, "weights"_a, "threshold"_a, "smooth"_a, "rest"_a,
        "tolerance"_a, "max_iterations"_a, "is_warm_start"_a,
        R"(Fit blend-shape weights and the head's pose to landmarks over frames.

Landmark n of a face is at ``R (neutral[n] + sum of w[s] deltas[s, n]) + t``; ``neutral``
``(1, N, 3)``, or ``(F, N, 3)`` with one a frame. ``observed`` is ``(F, N, 3)`` in that unit, or
with a ``camera`` fx, fy, cx, cy ``(F, N, 2)`` in pixels. The camera looks along +Z. A missing
landmark is NaN. ``poses`` ``(F, 7)``, quaternions x y z w and t, and ``weights`` ``(F, S)`` are
the initial values. Weights stay between 0 and 1. The cost includes ``smooth`` times the squared
differences of weights from frame to frame, and ``rest`` times the squared weights. Residuals
beyond the ``threshold`` have a smaller weight.

Returns ``(weights, poses, residuals, shares, rounds, change)``: lengths of the residuals
``(F, N)``, NaN if missing; the weight of each residual, 0 to 1; the number of iterations; the
largest change of a weight in the last iteration. Iterations end when it is below ten times
``tolerance``. With ``is_warm_start``, the start is near the solution, so outliers are rejected from the start.)");

  m.def("triangulate_points", &triangulate_points, WithoutLock(), "pixels"_a,
        "confidences"_a.none(), "cameras"_a, "is_active"_a, "noise"_a, "outlier_gate"_a,
        "max_condition"_a, "has_details"_a,
        R"(Find points from the pixels ``(F, C, M, 2)`` at which C cameras see them.

A NaN pixel is not visible. ``confidences`` ``(F, C, M)`` weight pixels; 0 is not visible.
``cameras`` ``(C, 27)``: fx fy cx cy skew [px], k1 k2 p1 p2 k3 k4 k5 k6, the rotation by rows and
the translation [m] from the world to the camera, width and height [px] or 0. ``is_active``
``(F, C)``: cameras that are used. ``noise`` ``(C,)``: standard deviation of a pixel along each
axis [px]. Observations with a residual above ``outlier_gate`` standard deviations are rejected. Points
are omitted if the product of the traces of their normal matrix and of its inverse exceeds
``max_condition``.

Returns ``(points, numbers, tallies, residuals, states)``: ``(F, M, 3)`` [m], NaN if fewer
than two cameras agree; ``(F, M, 5)``: root mean square of the used residuals [px] and [m], the
standard error [m], the number of used cameras, and of cameras that see the point; ``(F, C, 8)``:
the numbers of all observations, and of those that are used, tested, rejected and outside the
domain of the lens, the sums of squared residuals [px^2] and [m^2], and the number of
observations outside the image. If ``has_details``, otherwise empty: residuals ``(F, C, M, 2)`` [px],
and ``(F, C, M)``: 0 not visible, 1 used, 2 rejected, 3 not active, 4 outside the domain, 5 the
point is not found.)");

  m.def("least_median_residuals", &least_median_residuals, WithoutLock(), "pixels"_a, "cameras"_a,
        R"(Return the least median of residuals over all pairs of cameras ``(F, M)`` [px].

NaN if fewer than three cameras see a point. Arguments are those of `triangulate_points`.)");
}

}  // namespace animtool
