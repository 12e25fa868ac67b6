"""Checks of crowds: who comes through, and whose hips stay up."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import UsdGeom

from support.reported.bodies import read_bodies
from support.reported.outcome import Outcome, require
from support.reported.stages import PosedSkeleton, open_clocked, skeletons

Floats = npt.NDArray[np.float64]
# Who lies: the head is less than this above the hips, in shares of the way between.
UPRIGHT = 0.5
# One who gets up or falls is as low for some time before and after [s].
FALLING = 1.0
HIPS, HEAD = ("hips", "pelvis", "root"), ("head",)


def _agents(outcome: Outcome, of: str | None, system: str | None) -> tuple[Any, Floats]:
    """Return the stage and the places of agents ``(F, N, 3)`` [m]."""
    path = outcome.file(of)
    clocked = open_clocked(path)
    if clocked.prims(UsdGeom.PointInstancer) or clocked.prims(UsdGeom.Points):
        bodies = read_bodies(outcome, of, system)
        return bodies.clocked, bodies.centres
    own = skeletons(path)
    places = [each.positions()[:, _joint(each, HIPS)] for each in own]
    return clocked, np.stack(places, axis=1)


def crowd_through(
    outcome: Outcome,
    *,
    seconds: float,
    first: int,
    beyond: float,
    min: int,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require how many agents are beyond a distance of x on their far side.

    The first ones go towards +x, all others the other way. Who is gone by then counts
    where they were last.
    """
    clocked, places = _agents(outcome, of, system)
    count = places.shape[1]
    require(0 < first <= count, f"{count} agents, not {first} or more")
    along = places[: int(clocked.at(seconds)) + 1, :, 0]
    seen = np.isfinite(along)
    require(seen.any(axis=0).all(), "an agent is never there")
    last = len(along) - 1 - seen[::-1].argmax(axis=0)
    sign = np.where(np.arange(count) < first, 1.0, -1.0)
    reached = sign * along[last, np.arange(count)]
    begun = sign * along[seen.argmax(axis=0), np.arange(count)]
    require((begun < beyond).all(), "an agent begins on its far side")
    through = int((reached > beyond).sum())
    require(through >= min, f"{through} of {count} are through, not {min}")


def _joint(skeleton: PosedSkeleton, names: tuple[str, ...]) -> int:
    """Return the first joint that is called so."""
    lower = [name.lower() for name in skeleton.names]
    index = next((lower.index(name) for name in names if name in lower), None)
    require(index is not None, f"no joint of {names} among {skeleton.names}")
    assert index is not None
    return index


def crowd_hips(
    outcome: Outcome, *, above: float, step: float, of: str | None = None
) -> None:
    """Require that only who falls has low hips, and that no hips pop."""
    for number, skeleton in enumerate(skeletons(outcome.file(of)), 1):
        places = skeleton.positions()
        hips, head = (places[:, _joint(skeleton, names)] for names in (HIPS, HEAD))
        require(np.isfinite(places).all(), f"agent {number} is not finite")
        low = np.flatnonzero(hips[:, 1] < above)
        fps = skeleton.clocked.fps
        standing = low[~_falls(hips, head, fps)[low]]
        text = f"the hips of agent {number} are {hips[:, 1].min():.3f} m up"
        frames = (standing[:5] + 1).tolist()
        require(not len(standing), f"{text}, and it stands, in frames {frames}")
        steps = np.linalg.norm(np.diff(hips, axis=0), axis=1)
        require(len(steps), "there is one frame, and no step")
        text = f"the hips of agent {number} move {steps.max():.3f} m"
        require(steps.max() <= step, f"{text} to frame {int(steps.argmax()) + 2}")


def _falls(hips: Floats, head: Floats, fps: float) -> npt.NDArray[np.bool_]:
    """Return the frames in which one lies, falls or gets up ``(F,)``."""
    spine = head - hips
    lies = spine[:, 1] < UPRIGHT * np.linalg.norm(spine, axis=1)
    reach = round(FALLING * fps)
    frames = np.flatnonzero(lies)
    near = np.abs(np.arange(len(lies))[:, None] - frames).min(axis=1, initial=10**6)
    return np.asarray(near <= reach)


CHECKS = {
    "crowd_hips": crowd_hips,
    "crowd_through": crowd_through,
}
