"""Evaluates drivers on the motion of rigs; driven values replace the source's.

The result depends only on the pose and controls of each frame, so evaluating again
changes nothing. Angles of unlimited pins are the one exception: revolutions are counted
from the first frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import IntArray
from animtool.core.errors import Fault
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import Shape

# Codes that drivers report again for the same joint after every pass.
REPEATED_CODES = frozenset({"RIG103", "RIG105"})


def drive_take(take: Take) -> Take:
    """Return a take with driven joints, shapes and controls evaluated.

    Adds a notice for each joint whose driver exceeds its limits.
    """
    if not take.rig.is_driven:
        return take
    from animtool.motion.driver_run import DriverRun

    run = DriverRun(take.rig)
    motion = run.evaluate(take.motion, np.asarray(take.clock.times, np.float64))
    new_notices = drop_repeated_notices(run.notices(), take.notices)
    return replace(take, motion=motion, notices=(*take.notices, *new_notices))


def drive_stream(stream: TakeStream, *, reports_replaced: bool = False) -> TakeStream:
    """Return a stream with driven joints, shapes and controls evaluated.

    Warnings of drivers are added to its notices once the blocks are read;
    ``reports_replaced`` adds those of source motion that drivers replace.
    """
    if not stream.rig.is_driven:
        return stream
    from animtool.motion.driver_run import DriverRun

    run = DriverRun(stream.rig, reports_replaced)
    start, rig = float(stream.start or 1), stream.rig

    def blocks() -> Iterator[Motion]:
        """Yield the driven blocks; add the warnings at the end."""
        frames_done = 0
        for block in stream.blocks:
            indices = frames_done + np.arange(block.frames, dtype=np.float64)
            times = start + float(stream.step) * indices
            frames_done += block.frames
            yield run.evaluate(block, times)
        stream.notices.extend(drop_repeated_notices(run.notices(), stream.notices))

    result = replace(stream, blocks=blocks())
    curve = stream.curve
    if curve is not None:
        # Each call begins anew, as its times may be in any order.
        result.curve = lambda times: DriverRun(rig).evaluate(curve(times), times)
    return result


def drop_repeated_notices(
    notices: Iterable[Fault], reported_notices: Iterable[Fault]
) -> list[Fault]:
    """Return the notices without driver warnings that were already reported."""
    known_notices = {
        (notice.code, _first_name(notice))
        for notice in reported_notices
        if notice.code in REPEATED_CODES
    }
    return [n for n in notices if (n.code, _first_name(n)) not in known_notices]


def _first_name(notice: Fault) -> str:
    """Return the joint or control that a driver's notice names first."""
    quoted_parts = notice.message.split("'")
    return quoted_parts[1] if len(quoted_parts) > 2 else notice.message.split(" ")[0]


def combine_missing_weights(
    weights: Channel, shapes: Sequence[Shape], missing_shapes: IntArray
) -> Channel:
    """Return shape weights, with missing combination shapes set to their products.

    The weights of shapes that the motion lacks are 0 before.

    >>> shapes = [Shape("a"), Shape("b", combine=("a",)), Shape("c", combine=("a",))]
    >>> weights = Channel(np.zeros((3, 1)), np.array([0]), np.full((2, 1, 1), 0.5))
    >>> combined = combine_missing_weights(weights, shapes, np.array([1]))
    >>> combined.dense()[0, :, 0].tolist()
    [0.5, 0.5, 0.0]
    """
    from animtool.rig.shapes import combination_order

    index_by_shape = {shape.name: i for i, shape in enumerate(shapes)}
    missing_indices, rest = set(missing_shapes.tolist()), weights.rest.copy()
    values_by_shape = {
        int(i): weights.values[:, k] for k, i in enumerate(weights.animated)
    }
    for shape in combination_order(shapes):
        i = index_by_shape[shape.name]
        driver_indices = [index_by_shape[name] for name in shape.combine]
        if i not in missing_indices or not driver_indices:
            continue
        rest[i] = np.prod([rest[k] for k in driver_indices], axis=0)
        if any(k in values_by_shape for k in driver_indices):
            product = np.ones((len(weights.values), 1))
            for k in driver_indices:
                product = product * values_by_shape.get(k, rest[k])
            values_by_shape[i] = product
    if len(values_by_shape) == len(weights.animated):
        return replace(weights, rest=rest)
    animated_shapes = sorted(values_by_shape)
    values = np.stack([values_by_shape[i] for i in animated_shapes], axis=1)
    return Channel(rest, np.array(animated_shapes, np.int64), values)
