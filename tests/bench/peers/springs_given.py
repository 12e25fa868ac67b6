"""What every tool is given of springs, and how it is timed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from clock import Taken, now, since

FILM = 24
# Short runs are repeated for as long as this: the first are of a cold processor [s].
WARM = 0.5


@dataclass(frozen=True)
class Given:
    """A body of springs and what is asked for.

    Attributes:
        body: Arrays by name, as the benchmark saved them.
        rate: Steps a second.
        frames: Of film, after the first.
        output: Where places go.
        more: What only this tool is told.
    """

    body: dict[str, Any]
    rate: int
    frames: int
    output: Path
    more: list[str]

    @property
    def steps(self) -> int:
        """Steps of a frame."""
        return self.rate // FILM


def given() -> Given:
    """Read what this process was asked."""
    body, rate, frames, output, *more = sys.argv[1:]
    with np.load(body) as arrays:
        kept = dict(arrays)
    return Given(kept, int(rate), int(frames), Path(output), more)


def measure(asked: Given, run: Callable[[], Any]) -> None:
    """Time a run that returns places at every frame, save these, print what it took.

    Short runs are repeated, and the one that took the processor least counts.
    """
    taken: list[Taken] = []
    places = None
    while sum(one.wall for one in taken) < WARM:
        began = now()
        places = run()
        taken.append(since(began))
    np.save(asked.output, np.asarray(places, np.float64))
    print(json.dumps({"taken": [min(taken, key=lambda one: one.cpu)]}))
