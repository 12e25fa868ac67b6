"""Filters known messages that USD prints to stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO

from animtool.core.quantities import escaped_lines

# Warnings that USD prints for every file with splines or time codes in metadata; users
# cannot act on them.
VERSION_WARNINGS = (
    b"inner looping is deprecated",
    b"A spline was detected which requires",
    b"A timecode or timecode[] value type was detected which requires",
)
# Beginnings of USD's diagnostic lines.
_DIAGNOSTIC_PREFIXES = (
    b"Warning: in ",
    b"Error in ",
    b"Coding Error: in ",
    b"Runtime Error: in ",
)
# Beginning of the last line of a diagnostic that has several, such as a cycle.
_LAST_LINE_PREFIX = b" ("


@contextmanager
def without_usd_warnings(
    dropped_texts: tuple[bytes, ...] = _DIAGNOSTIC_PREFIXES,
) -> Iterator[None]:
    """Drop USD's warnings printed in the context: all, or those with certain texts.

    USD prints them to the process's stderr, bypassing Python. Other output to stderr is
    printed afterwards.
    """
    import tempfile

    sys.stderr.flush()
    try:
        saved_fd = os.dup(2)
    except OSError:  # stderr is closed
        yield
        return
    buffer = None
    try:
        # On a full disk nothing can be captured, and USD's lines are printed directly.
        with suppress(OSError):
            buffer = tempfile.TemporaryFile()  # noqa: SIM115
            os.dup2(buffer.fileno(), 2)
        yield
    finally:
        with suppress(OSError):
            os.dup2(saved_fd, 2)
        with suppress(OSError):
            os.close(saved_fd)
        if buffer is not None:
            with suppress(OSError), buffer:
                _print_other_lines(buffer, dropped_texts)


def _print_other_lines(buffer: IO[bytes], dropped_texts: tuple[bytes, ...]) -> None:
    """Print the captured lines that contain none of the dropped texts."""
    buffer.seek(0)
    is_continued = False
    for line in buffer:
        if is_continued:
            is_continued = not line.startswith(_LAST_LINE_PREFIX)
        elif any(text in line for text in dropped_texts):
            is_continued = line.rstrip().endswith(b":")
        else:
            text = line.decode("utf-8", "surrogateescape")
            os.write(2, escaped_lines(text).encode())
