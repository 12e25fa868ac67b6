"""Another take brought onto the clock of a take."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.edit.places import even_places
from animtool.motion import Motion
from animtool.take import Take


def other_frames(
    other: Take,
    rate: Fraction,
    first: int,
    count: int,
    delay: Fraction = Fraction(0),
) -> Motion:
    """Return another take at some frames of a take, held at its ends.

    First frames coincide, whatever the time codes say.

    Args:
        other: The take to sample.
        rate: Frames a second of the take.
        first: Index of the first frame wanted.
        count: Number of frames wanted.
        delay: By how much the other starts later [frame].
    """
    ratio = other.clock.rate / rate
    index = np.arange(first, first + count)
    places = even_places(index, -delay, ratio, other.clock.count)
    return other.motion.map(places.blend)
