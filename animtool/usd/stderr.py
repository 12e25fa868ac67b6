"""What USD prints by itself."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from animtool.quantities import escaped_lines

# Of its own writers, about every file with a spline or with time codes in metadata:
# nothing that a user could change.
_KNOWN = (
    b"inner looping is deprecated",
    b"A spline was detected which requires",
    b"A timecode or timecode[] value type was detected which requires",
)
# How the lines of its diagnostics begin.
_DIAGNOSTICS = (
    b"Warning: in ",
    b"Error in ",
    b"Coding Error: in ",
    b"Runtime Error: in ",
)


@contextmanager
def without_version_warnings() -> Iterator[None]:
    """Leave out what USD's writers print about splines and time codes as such.

    They print to the process's stderr, past Python. Everything else that arrives
    there meanwhile is printed afterwards.
    """
    with _held(_KNOWN):
        yield


@contextmanager
def without_usd_warnings() -> Iterator[None]:
    """Leave out what USD prints about the layers that it opens.

    Everything else that arrives there meanwhile is printed afterwards.
    """
    with _held(_DIAGNOSTICS):
        yield


@contextmanager
def _held(known: tuple[bytes, ...]) -> Iterator[None]:
    sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:  # nobody listens
        yield
        return
    try:
        holder = tempfile.TemporaryFile()  # noqa: SIM115
    except OSError:  # no place to hold it: a full disk is for the output to report
        os.close(saved)
        yield
        return
    with holder as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            held.seek(0)
            for line in held:
                if not any(text in line for text in known):
                    text = line.decode("utf-8", "surrogateescape")
                    os.write(2, escaped_lines(text).encode())
