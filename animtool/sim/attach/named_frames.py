"""Frames that options of a simulation name, beside those that the take has."""

from __future__ import annotations

from animtool.errors import Fault, Severity, listed
from animtool.sim.attach.simulation import Simulation


def of_named_frames(simulation: Simulation) -> list[Fault]:
    """Return what is odd about the frames that options name, when all were seen.

    A frame that the take has not is named in vain (SIM185). Where a simulation goes on
    from a frame, those before it are as the take has them (SIM186).
    """
    options, codes, resumed = simulation.options, simulation.codes, simulation.resumed
    if not codes:
        return []
    named = {"save_at": options.save_at, "teleports": options.teleports}
    if resumed is not None:
        named["resume"] = (resumed.frame,)
    seen = set(codes)
    said = [
        _in_vain(name, missing, codes)
        for name, frames in named.items()
        if (missing := [frame for frame in frames if frame not in seen])
    ]
    if resumed is not None and codes[0] < resumed.frame <= codes[-1]:
        frame = f"{resumed.frame:g}"
        message = (
            f"it goes on from frame {frame}; those before are as the take has them"
        )
        said.append(Fault("SIM186", message, severity=Severity.NOTE))
    return said


def _in_vain(option: str, frames: list[float], codes: list[float]) -> Fault:
    noun = "frame" if len(frames) == 1 else "frames"
    message = f"{option} names {noun} {listed([f'{frame:g}' for frame in frames])}"
    message += f", and the take has {codes[0]:g} to {codes[-1]:g}"
    hint = "frames are named by their time codes in the take"
    return Fault("SIM185", message, hint=hint, severity=Severity.WARNING)
