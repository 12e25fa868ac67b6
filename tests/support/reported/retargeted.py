"""Checks of hips that were retargeted, by a plain reader of BVH."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from support.bvh import ReferenceBvh, read_reference
from support.reported.outcome import Outcome, require

Floats = npt.NDArray[np.float64]
_FOOT = re.compile(r"foot|ankle", re.IGNORECASE)
# Of a BVH [m].
CENTIMETRE = 0.01


def _legs(bvh: ReferenceBvh) -> float:
    """Return the mean length of the legs, from hip to ankle."""
    lengths = []
    for joint, name in enumerate(bvh.names):
        if not _FOOT.search(name):
            continue
        length, at = 0.0, joint
        # The offset of the joint below the root is the width of the hips.
        while bvh.parents[at] > 0:
            length += float(np.linalg.norm(bvh.offsets[at]))
            at = bvh.parents[at]
        lengths.append(length)
    require(lengths, f"no foot among {bvh.names}")
    require(min(lengths) > 0.0, "a leg has no length")
    return float(np.mean(lengths))


def _hips(bvh: ReferenceBvh) -> Floats:
    """Return the places of the root ``(F, 3)`` in units of the file."""
    require(len(bvh.rows) > 2, "there are too few frames")
    return bvh.positions(np.arange(len(bvh.rows)))[:, 0]


def _dip(hips: Floats) -> float:
    """Return how far hips go up and down."""
    return float(np.ptp(hips[:, 1]))


def _acceleration(hips: Floats, frame_time: float) -> float:
    """Return the rms acceleration of hips, by second differences."""
    second = np.diff(hips, n=2, axis=0) / frame_time**2
    return float(np.sqrt((second**2).sum(axis=1).mean()))


def retarget_scores(
    outcome: Outcome,
    *,
    source: str,
    dip_ratio: float,
    acceleration_ratio: float,
    of: str | None = None,
) -> None:
    """Require that hips dip and accelerate as the source's at the scale of the legs."""
    result = read_reference(outcome.file(of))
    start = read_reference(_source(outcome, source))
    scale = _legs(result) / _legs(start)
    hips, given = _hips(result), scale * _hips(start)
    dips = _dip(hips), _dip(given)
    rates = (
        _acceleration(hips, result.frame_time),
        _acceleration(given, start.frame_time),
    )
    require(dips[1] > 0 and rates[1] > 0, "the hips of the source do not move")
    require(dips[0] > 0 and rates[0] > 0, "the hips of the result do not move")
    faults = []
    for name, unit, (got, wanted), most in (
        ("dip", "m", dips, dip_ratio),
        ("acceleration", "m/s²", rates, acceleration_ratio),
    ):
        if not got <= most * wanted:
            text = f"{CENTIMETRE * got:.4g} {unit} for {CENTIMETRE * wanted:.4g}"
            faults.append(f"{name} {text}: {got / wanted:.2f} times, at most {most}")
    require(not faults, "; ".join(faults))


def _source(outcome: Outcome, source: str) -> Path:
    path = outcome.folder / source
    require(path.is_file(), f"there is no {source}")
    return path


CHECKS = {"retarget_scores": retarget_scores}
