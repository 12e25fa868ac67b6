"""Tracks that are known at some frames, in place of functions of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool._types import FloatArray
from animtool.edit.places import nearby_places
from animtool.motion import Channel
from animtool.transforms import Track, Transforms


def mapped_numbers(
    track: Track, known: Transforms, function: Callable[[FloatArray], FloatArray]
) -> Transforms:
    """Return transforms with a function applied to everything that is a number.

    Args:
        track: Whose they are.
        known: The transforms, F of them.
        function: From ``(F, A, K)`` with K = 4 for rotations alone.
    """

    def numbers(values: FloatArray) -> FloatArray:
        columns = values.reshape(len(values), -1, 1)
        made = function(columns)
        return made.reshape(len(made), *values.shape[1:])

    return Transforms(
        numbers(known.translations),
        function(known.rotations[:, None])[:, 0],
        numbers(known.scales),
        None if known.matrices is None else numbers(known.matrices),
        tuple(
            numbers(values) if attribute.width else values
            for attribute, values in zip(track.attributes, known.values, strict=True)
        ),
        known.held,
    )


def gridded(track: Track, known: Transforms) -> Track:
    """Return a track that is known at times 0, 1, 2 ..., and is held at its ends.

    Between two of them rotations go along the shortest arc and numbers in a straight
    line; choices last until the next.
    """
    count = len(known)

    def sample(times: FloatArray) -> Transforms:
        places = nearby_places(times, count)

        def between(values: FloatArray) -> FloatArray:
            every = np.arange(values.shape[1])
            return places.blend(Channel(values[0], every, values)).values

        made = mapped_numbers(track, known, between)
        values = tuple(
            made.values[i] if attribute.width else known.values[i][places.frames]
            for i, attribute in enumerate(track.attributes)
        )
        held = None if known.held is None else known.held[places.frames]
        return replace(made, values=values, held=held)

    return replace(track, sample=sample)
