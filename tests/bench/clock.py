"""Wall and CPU seconds of work, in any interpreter: peers time themselves by it.

Only the standard library is imported here.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from typing import NamedTuple


class Taken(NamedTuple):
    """What some work took, or a moment from which that is counted.

    Attributes:
        wall: Seconds that passed [s].
        cpu: User and system time of all threads and of children that ended [s].
    """

    wall: float
    cpu: float


def now() -> Taken:
    """Return this moment."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = time.process_time() + children.ru_utime + children.ru_stime
    return Taken(time.perf_counter(), spent)


def since(began: Taken) -> Taken:
    """Return what it took from a moment to now."""
    wall = time.perf_counter()
    return Taken(wall - began.wall, now().cpu - began.cpu)


def timed(work: Callable[[], object]) -> Taken:
    """Return what some work takes; its result is freed untimed."""
    began = now()
    result = work()
    taken = since(began)
    del result
    return taken
