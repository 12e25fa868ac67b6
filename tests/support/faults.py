"""Files with faults, and where these are said to be."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from animtool.core.errors import AnimtoolError, FormatError

# Text to find, text to put there, code, line.
Planted = tuple[str, str, str, int]


@contextmanager
def raises(
    kind: type[AnimtoolError] | tuple[type[Exception], ...],
    *codes: str,
    match: str | None = None,
) -> Iterator[pytest.ExceptionInfo[AnimtoolError]]:
    """Check that an error is raised for faults of some codes alone.

    Args:
        kind: Of the error.
        codes: Of its faults, in their order.
        match: What the message has besides, such as a name or a number.
    """
    with pytest.raises(kind, match=match) as caught:
        yield caught
    assert tuple(fault.code for fault in caught.value.faults) == codes


@contextmanager
def refused(*expected: tuple[str, int]) -> Iterator[None]:
    """Check that a file is refused, for faults of some codes at some lines alone."""
    with pytest.raises(FormatError) as caught:
        yield
    assert [(f.code, f.lines[0]) for f in caught.value.faults] == list(expected)


def document_faults(kind: str, line: str, number: int) -> list[Planted]:
    """Return faults that a file of any kind may have.

    Args:
        kind: What the file is; its first line says it.
        line: A key and its value, which may be left out.
        number: Where that stands, from 1 on.
    """
    key, _, value = line.partition(": ")
    planted = [
        (f"{key}: [{value}", "DOC001", number),
        (f"{key}: &r {value}", "DOC002", number),
        (f"{key}: *r", "DOC002", number),
        (f"{key}: !!str {value}", "DOC003", number),
        (f"{line}\n{line}", "DOC004", number + 1),
        (f"{key}: " + "[" * 60 + "]" * 60, "DOC005", number),
        (f"{line}\n---", "DOC007", number + 1),
        (f"{key}: \udce9", "DOC008", number),
        (f"8: {value}", "DOC010", number),
        (f"{key}x: {value}", "DOC020", number),
    ]
    head = f"{kind}: animtool/1"
    return [
        *((line, new, code, at) for new, code, at in planted),
        (head, "targets: animtool/1", "DOC009", 1),
        (head, f"{kind}: 1", "DOC009", 1),
        (head, f"{kind}: animtool/9", "DOC012", 1),
    ]
