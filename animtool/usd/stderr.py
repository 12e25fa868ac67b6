"""What USD prints by itself."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["without_version_warnings"]

# Of its own writers, about every file with a spline or with time codes in metadata:
# nothing that a user could change.
_KNOWN = (
    b"inner looping is deprecated",
    b"A spline was detected which requires",
    b"A timecode or timecode[] value type was detected which requires",
)


@contextmanager
def without_version_warnings() -> Iterator[None]:
    """Leave out what USD's writers print about splines and time codes as such.

    They print to the process's stderr, past Python. Everything else that arrives
    there meanwhile is printed afterwards.
    """
    sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:  # nobody listens
        yield
        return
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            held.seek(0)
            for line in held:
                if not any(known in line for known in _KNOWN):
                    os.write(2, line)
