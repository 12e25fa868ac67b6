"""A process that makes items, one after another, for the run that started it."""

from __future__ import annotations

import contextlib
import os
import sys
from dataclasses import dataclass
from multiprocessing.connection import Connection

from animtool.batch.requirements import import_needed
from animtool.batch.work import Maker
from animtool.supervisor import follow_parent, report_reading

# What a worker sends once it can take items.
READY = "ready"


@dataclass(frozen=True, slots=True)
class Reading:
    """Names the file that USD reads in a worker; empty when it was read."""

    path: str


def serve(connection: Connection, maker: Maker, memory: int | None) -> None:
    """Make the items that come in, and send what became of each, until none comes.

    Args:
        connection: To the run.
        maker: What makes them.
        memory: What this process may have [bytes]; None is any.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    follow_parent()
    # What is imported before the first item takes none of its time.
    import_needed(maker.recipe)
    from animtool.usd.layers import compute_alone

    compute_alone()
    if memory is not None:
        _limit_memory(memory)
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        connection.send(READY)
        report_reading(lambda path: connection.send(Reading(path)))
        while (item := connection.recv()) is not None:
            outcome = maker.make(item)
            connection.send(outcome)
            if outcome.retired:
                return


def _limit_memory(memory: int) -> None:
    """Let allocations fail that lead beyond a limit, where systems can do that.

    What is mapped already counts twice in part: the limit errs on the large side, and
    the run watches what is really used.
    """
    if sys.platform == "win32":
        return
    import resource

    mapped = mapped_bytes()
    if mapped is not None:
        with contextlib.suppress(OSError, ValueError):
            most = resource.getrlimit(resource.RLIMIT_AS)[1]
            wanted = mapped + memory
            if most != resource.RLIM_INFINITY:
                wanted = min(wanted, most)
            resource.setrlimit(resource.RLIMIT_AS, (wanted, most))


def mapped_bytes() -> int | None:
    """Return how much this process has mapped [bytes]; None where nothing says it."""
    try:
        with open("/proc/self/statm", "rb") as file:  # noqa: PTH123
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None
