"""Which alternative of a row holds, and why the others do not."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from support.reported import (
    bodies,
    c3d,
    captures,
    crowds,
    joints,
    meshes,
    retargeted,
    said,
    shots,
    springs,
    surfaces,
)
from support.reported.outcome import Outcome, UnmetError
from support.reported.running import faults_of

# A check takes an outcome, and what the table says as keyword arguments.
Check = Callable[..., None]
CHECKS: dict[str, Check] = {}
for _module in (
    *(bodies, c3d, captures, crowds, joints, meshes),
    *(retargeted, said, shots, springs, surfaces),
):
    CHECKS.update(_module.CHECKS)


def unmet(outcome: Outcome, accept: tuple[Mapping[str, Any], ...]) -> list[str]:
    """Return why no alternative holds; nothing where one does.

    What the table asks and is not known here is never met.
    """
    reasons = [f"in any row: {fault}" for fault in faults_of(outcome.done)]
    if reasons:
        return reasons
    if not accept:
        return ["the row accepts nothing"]
    for number, alternative in enumerate(accept, 1):
        faults = _alternative(outcome, alternative)
        if not faults:
            return []
        which = f"alternative {number}: " if len(accept) > 1 else ""
        reasons += [f"{which}{fault}" for fault in faults]
    return reasons


def _alternative(outcome: Outcome, alternative: Mapping[str, Any]) -> list[str]:
    """Return what of an alternative does not hold."""
    unknown = alternative.keys() - {"exit", "codes", "checks"}
    faults = [f"unknown key {key!r} of an alternative" for key in sorted(unknown)]
    exits = alternative.get("exit", 0)
    allowed = exits if isinstance(exits, list) else [exits]
    if outcome.done.code not in allowed:
        faults.append(f"exit {outcome.done.code}, not {_either(allowed)}")
    begins = tuple(alternative.get("codes", ()))
    if begins and not any(code.startswith(begins) for code in outcome.codes):
        faults.append(f"no code {_either(begins)} among {sorted(outcome.codes)}")
    for check in alternative.get("checks", ()):
        faults += _check(outcome, check)
    return faults


def _check(outcome: Outcome, check: Mapping[str, Any]) -> list[str]:
    """Return what of a check does not hold."""
    words = dict(check)
    what = words.pop("what", None)
    if what not in CHECKS:
        return [f"unknown check {what!r}"]
    try:
        inspect.signature(CHECKS[what]).bind(outcome, **words)
    except TypeError as error:
        return [f"{what}: {error}"]
    try:
        CHECKS[what](outcome, **words)
    except UnmetError as error:
        return [f"{what}: {error}"]
    except Exception as error:
        # A result that can not even be read is not as asked.
        return [f"{what}: {type(error).__name__}: {error}"]
    return []


def _either(values: Any) -> str:
    return " or ".join(map(str, values))
