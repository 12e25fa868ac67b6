"""Plausibility checks of option values about a take."""

from __future__ import annotations

from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.errors import Fault, Severity

# Captures and displays are slower; a larger number is probably not a frame rate.
MAX_PLAUSIBLE_RATE = 2000


def rate_warning(fps: Fraction, name: str | None = "fps") -> list[Fault]:
    """Return a warning about an implausible number of frames a second (TAKE009).

    name: Of the argument that sets the rate; None where only the file does.
    """
    if 1 <= fps <= MAX_PLAUSIBLE_RATE:
        return []
    stated = f"{float(fps):g}"
    stated = f"fps {stated}" if name is None else argument(name, stated)
    message = (
        f"{stated} is implausible; film has 24 frames a second, captures up to 1000"
    )
    hint = "use the number of frames in one second, not their total or a frame time"
    return [Fault("TAKE009", message, hint=hint, severity=Severity.WARNING)]
