"""Checks of what a command says, and of which files it leaves."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from support.reported.outcome import Outcome, require

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:,\d{3})*(?:\.\d+)?(?:[eE][-+]?\d+)?")


def message_contains(
    outcome: Outcome, *, any: Sequence[str] = (), all: Sequence[str] = ()
) -> None:
    """Require texts in what is said, whatever the case."""
    require(any or all, "no text is given")
    text = outcome.text.lower()
    missing = [each for each in all if each.lower() not in text]
    require(not missing, f"does not say {missing}")
    found = [each for each in any if each.lower() in text]
    require(found or not any, f"says none of {list(any)}")


def message_lacks(outcome: Outcome, *, any: Sequence[str]) -> None:
    """Require that texts are not in what is said, whatever the case."""
    require(any, "no text is given")
    text = outcome.text.lower()
    found = [each for each in any if each.lower() in text]
    require(not found, f"says {found}")


def codes(
    outcome: Outcome,
    *,
    any: Sequence[str] = (),
    all: Sequence[str] = (),
    none: Sequence[str] = (),
    new: Sequence[str] | None = None,
) -> None:
    """Require codes by what they begin with; `new` are those that do not count."""
    require(any or all or none or new is not None, "no code is given")
    printed = outcome.codes

    def begun(begin: str) -> list[str]:
        return sorted(code for code in printed if code.startswith(begin))

    named = f"among {sorted(printed)}"
    require(not any or [c for begin in any for c in begun(begin)], f"no {any} {named}")
    missing = [begin for begin in all if not begun(begin)]
    require(not missing, f"no {missing} {named}")
    found = [code for begin in none for code in begun(begin)]
    require(not found, f"{found} is said")
    if new is not None:
        fresh = [code for code in printed if not code.startswith(tuple(new))]
        require(fresh, f"no code beyond {list(new)} {named}")


def count_of(outcome: Outcome, *, text: str, min: int) -> None:
    """Require that something is said often enough."""
    require(text, "no text is given")
    count = outcome.text.count(text)
    require(count >= min, f"{text} {count} times, not {min}")


def says_number(
    outcome: Outcome,
    *,
    value: float | Sequence[float],
    tolerance: float,
    code: str | None = None,
) -> None:
    """Require a number near one of some; `tolerance` is a share."""
    wanted = np.atleast_1d(np.asarray(value, float))
    require(len(wanted), "no number is given")
    texts = [text for line in outcome.lines(code) for text in _NUMBER.findall(line)]
    numbers = np.array([float(text.replace(",", "")) for text in texts])
    apart = np.abs(numbers[:, None] - wanted)
    said = " ".join(texts[:40])
    require((apart <= tolerance * np.abs(wanted)).any(), f"not {value} in: {said}")


def files(outcome: Outcome, *, names: Sequence[str]) -> None:
    """Require that these were written and no others."""
    require(outcome.files == sorted(names), f"{outcome.files}, not {sorted(names)}")


def memory_mb(outcome: Outcome, *, max: float) -> None:
    """Require that the process kept within some memory."""
    peak = outcome.done.peak_mb
    require(peak > 0.0, "the memory was not measured")
    require(peak <= max, f"{peak:.0f} MB, at most {max}")


CHECKS = {
    "codes": codes,
    "count_of": count_of,
    "files": files,
    "memory_mb": memory_mb,
    "message_contains": message_contains,
    "message_lacks": message_lacks,
    "says_number": says_number,
}
