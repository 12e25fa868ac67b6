"""Checks on splines, and on samples where there can be none."""

from __future__ import annotations

from collections.abc import Iterator

from pxr import Sdf

from animtool.errors import Fault, counted
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.table import finding


def check_splines(subject: Subject) -> Iterator[Fault]:
    """Check that splines go forward in time, and that no samples hide them.

    A knot that is not finite is refused by USD as the layer is read.
    """
    for attr in subject.attributes:
        specs = [spec for spec in attr.GetPropertyStack() if spec.HasSpline()]
        if not specs:
            continue
        spline = specs[0].GetSpline()
        if spline.HasRegressiveTangents():
            message = f"tangents of some of its {len(spline.GetKnots())} knots do"
            yield finding("USD274", attr.GetPath(), message)
        # Of one layer, samples win; a stronger layer may replace a spline by samples.
        layer, path = specs[0].layer, specs[0].path
        samples = layer.ListTimeSamplesForPath(path)
        if samples:
            message = (
                f"{counted(len(samples), 'sample')} and "
                f"{counted(len(spline.GetKnots()), 'knot')}"
            )
            yield finding("USD275", attr.GetPath(), message)


def check_uniform(subject: Subject) -> Iterator[Fault]:
    """Check that no uniform attribute has samples."""
    for attr in subject.attributes:
        if attr.GetVariability() != Sdf.VariabilityUniform:
            continue
        times = subject.times(attr)
        if times:
            message = (
                f"{counted(len(times), 'sample')} from time code {times[0]:g} on a "
                "uniform attribute"
            )
            yield finding("USD211", attr.GetPath(), message)
