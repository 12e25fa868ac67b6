"""Checks of joints: where they are, and how they turn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from support.bvh import read_reference
from support.reported.outcome import Outcome, require
from support.reported.stages import (
    PosedSkeleton,
    sample_codes,
    skeleton_with,
    skeletons,
)

Floats = npt.NDArray[np.float64]
# Of a BVH [m].
CENTIMETRE = 0.01


def _over(outcome: Outcome, over: str | None) -> Path | None:
    return None if over is None else outcome.file(over)


def _skeleton(
    outcome: Outcome, joint: str, of: str | None, over: str | None
) -> PosedSkeleton:
    return skeleton_with(outcome.file(of), joint, _over(outcome, over))


def joint_world(
    outcome: Outcome,
    *,
    joint: str,
    value: Any,
    tolerance: float,
    time: float | None = None,
    frame: int | None = None,
    of: str | None = None,
    over: str | None = None,
) -> None:
    """Require where a joint is, at a time code or some frames after the start."""
    require((time is None) != (frame is None), "give a time or a frame")
    skeleton = _skeleton(outcome, joint, of, over)
    codes = skeleton.clocked.codes
    if frame is not None:
        require(
            frame < len(codes), f"{len(codes)} frames, none {frame} after the first"
        )
    code = codes[frame] if frame is not None else time
    inside = codes[0] <= code <= codes[-1]
    require(inside, f"no frame {code} in {codes[0]:g} to {codes[-1]:g}")
    place = skeleton.world(np.array([code]))[0, skeleton.index(joint)]
    off = float(np.abs(place - np.asarray(value, float)).max())
    text = f"{joint} at {code:g}: {np.round(place, 5).tolist()}, off by {off:.4g} m"
    require(off <= tolerance, text)


def joint_curve(
    outcome: Outcome,
    *,
    joint: str,
    axis: str,
    times: Sequence[float],
    values: Sequence[float],
    tolerance: float,
    of: str | None = None,
    over: str | None = None,
) -> None:
    """Require one axis of a joint's place at some time codes."""
    require(len(times) == len(values) > 0, "as many times as values, at least one")
    skeleton = _skeleton(outcome, joint, of, over)
    codes = skeleton.clocked.codes
    inside = codes[0] <= min(times) and max(times) <= codes[-1]
    require(
        inside, f"frames {codes[0]:g} to {codes[-1]:g}, not {times[0]} to {times[-1]}"
    )
    places = skeleton.world(np.asarray(times, float))[:, skeleton.index(joint)]
    off = np.abs(places[:, "xyz".index(axis)] - np.asarray(values, float))
    worst = int(off.argmax())
    text = f"{joint}.{axis} is off by {off[worst]:.4g} m at {times[worst]}"
    require(off.max() <= tolerance, text)


def whole_samples(outcome: Outcome, *, of: str | None = None) -> None:
    """Require that all samples are on whole frames."""
    stage = skeletons(outcome.file(of))[0].clocked.stage
    codes = np.array(sample_codes(stage))
    require(len(codes) > 1, "nothing is sampled")
    between = codes[np.abs(codes - np.round(codes)) > 1e-6]
    require(not len(between), f"samples at {between[:5].tolist()}")


def upright(
    outcome: Outcome,
    *,
    high: str,
    low: str,
    min: float,
    first: bool = False,
    axis: str = "y",
    of: str | None = None,
    over: str | None = None,
) -> None:
    """Require that a joint is so far above another in every 8th frame."""
    path = outcome.file(of)
    if path.suffix == ".bvh":
        bvh = read_reference(path)
        missing = [name for name in (high, low) if name not in bvh.names]
        require(not missing, f"no joint {missing} among {bvh.names}")
        places = CENTIMETRE * bvh.positions(np.arange(len(bvh.rows)))
        pair = places[:, [bvh.names.index(name) for name in (high, low)]]
    else:
        require(axis == "y", "a stage is turned to Y up")
        skeleton = skeleton_with(path, high, _over(outcome, over))
        places = skeleton.positions()
        pair = places[:, [skeleton.index(name) for name in (high, low)]]
    require(len(pair), "there are no frames")
    above = (pair[:, 0] - pair[:, 1])[: 1 if first else None : 8, "xyz".index(axis)]
    worst = int(above.argmin())
    text = f"{high} is {above[worst]:.3f} m above {low} in frame {8 * worst + 1}"
    require(above.min() >= min, f"{text}, not {min}")


def turns_of(
    outcome: Outcome, of: str | None, over: str | None
) -> tuple[Floats, list[str], Floats]:
    """Return how far joints turn from frame to frame ``(F - 1, J)`` [deg].

    With their names, and the time codes that they turn to.
    """
    path = outcome.file(of)
    if path.suffix == ".bvh":
        bvh = read_reference(path)
        rotations, names = bvh.rotations(np.arange(len(bvh.rows))), bvh.names
        codes = 1.0 + np.arange(len(bvh.rows))
    else:
        skeleton = skeletons(path, _over(outcome, over))[0]
        rotations, names = skeleton.rotations(), skeleton.names
        codes = skeleton.clocked.codes
    require(len(rotations) > 1, "there is one frame, and no step")
    require(len(names), "there are no joints")
    require(np.isfinite(rotations).all(), "rotations are not finite")
    cosines = np.abs((rotations[1:] * rotations[:-1]).sum(axis=2)).clip(0.0, 1.0)
    return np.degrees(2.0 * np.arccos(cosines)), names, codes[1:]


def max_step_deg(
    outcome: Outcome, *, max: float, of: str | None = None, over: str | None = None
) -> None:
    """Require that no joint turns farther from a frame to the next."""
    turns, names, codes = turns_of(outcome, of, over)
    frame, joint = np.unravel_index(int(turns.argmax()), turns.shape)
    text = f"{names[joint]} turns {turns.max():.1f}° to frame {codes[frame]:g}"
    require(turns.max() <= max, f"{text}, at most {max}")


def jumps_named(
    outcome: Outcome, *, min: float, of: str | None = None, over: str | None = None
) -> None:
    """Require that the report names each frame to which a joint turns farther."""
    require("jumps" in outcome.report, "the report has no jumps")
    turns, names, codes = turns_of(outcome, of, over)
    named = np.array([float(jump["frame"]) for jump in outcome.report["jumps"]])
    for frame in np.flatnonzero(turns.max(axis=1) > min):
        joint = int(turns[frame].argmax())
        text = (
            f"{names[joint]} turns {turns[frame, joint]:.1f}° to frame {codes[frame]:g}"
        )
        known = np.isclose(named, codes[frame], rtol=0.0, atol=1e-6).any()
        require(known, f"{text}, which is not among the jumps {named.tolist()}")


def nearest(
    outcome: Outcome,
    *,
    joint: str,
    targets: Any,
    best: Sequence[float],
    tolerance: float,
    of: str | None = None,
    over: str | None = None,
) -> None:
    """Require that a joint is as near to its targets, frame by frame, as can be.

    Nearer is wrong too: then a limit is broken.
    """
    skeleton = _skeleton(outcome, joint, of, over)
    places = skeleton.positions()[:, skeleton.index(joint)]
    require(
        len(places) == len(targets) > 0, f"{len(places)} frames, not {len(targets)}"
    )
    distances = np.linalg.norm(places - np.asarray(targets, float), axis=1)
    off = distances - np.asarray(best, float)
    worst = int(np.abs(off).argmax())
    bad = int((np.abs(off) > tolerance).sum())
    code = skeleton.clocked.codes[worst]
    text = f"{distances[worst]:.4f} m from the target at frame {code:g}"
    require(not bad, f"{text}, the nearest is {best[worst]:.4f}; so {bad} frames")


def same_as(
    outcome: Outcome,
    *,
    joint: str,
    command: Sequence[str],
    tolerance: float,
    times: Sequence[float] | None = None,
    time: float | None = None,
    frame: int | None = None,
    of: str | None = None,
    over: str | None = None,
) -> None:
    """Require a joint where another command has it: at some time codes, else always."""
    require(outcome.run, "no other command can be run")
    assert outcome.run is not None
    other = outcome.run(list(command))
    require(other.done.code == 0, f"the other command: exit {other.done.code}")
    ours, theirs = (_skeleton(each, joint, of, over) for each in (outcome, other))
    codes = ours.clocked.codes
    if times is None and time is None and frame is None:
        same = np.array_equal(codes, theirs.clocked.codes)
        require(same, f"{len(codes)} frames, not {len(theirs.clocked.codes)}")
    elif frame is not None:
        require(
            frame < len(codes), f"{len(codes)} frames, none {frame} after the first"
        )
        codes = codes[[frame]]
    else:
        codes = np.asarray([time] if times is None else times, float)
    places = [each.world(codes)[:, each.index(joint)] for each in (ours, theirs)]
    off = np.abs(places[0] - places[1]).max(axis=1)
    worst = int(off.argmax())
    text = f"{joint} is {off[worst]:.4g} m off at {codes[worst]:g}"
    require(off.max() <= tolerance, text)


CHECKS = {
    "joint_curve": joint_curve,
    "joint_world": joint_world,
    "jumps_named": jumps_named,
    "max_step_deg": max_step_deg,
    "nearest": nearest,
    "same_as": same_as,
    "upright": upright,
    "whole_samples": whole_samples,
}
