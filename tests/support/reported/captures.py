"""Checks of captures, read from a written TRC or from what `info` says."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from support.bvh import read_reference
from support.reported.c3d import read_c3d
from support.reported.outcome import Outcome, close, require
from support.reported.stages import open_clocked, skeletons

Floats = npt.NDArray[np.float64]
# Metres.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}


@dataclass(frozen=True)
class Trc:
    """A TRC as its text has it.

    Attributes:
        names: Of the markers, empty where a column has none.
        points: ``(F, M, 3)`` [m], NaN where nothing is.
        seconds: ``(F,)``.
        rate: DataRate [1/s].
        rows: The lines of data.
    """

    names: list[str]
    points: Floats
    seconds: Floats
    rate: float
    rows: list[str]


def read_trc(path: Path) -> Trc:
    """Read a well-formed TRC, separated by tabs."""
    lines = path.read_text("utf-8").splitlines()
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    count, unit = int(header["NumMarkers"]), UNITS[header["Units"].strip()]
    names = [name.strip() for name in lines[3].split("\t")[2::3]]
    names = (names + [""] * count)[:count]
    rows = [line for line in lines[5:] if line.strip()]
    require(rows, "the TRC has no rows")
    require(count > 0, "the TRC has no markers")
    cells = [row.split("\t") for row in rows]
    few = [i for i, row in enumerate(cells, 1) if len(row) < 2 + 3 * count]
    require(not few, f"{count} markers, but rows {few[:5]} have fewer cells")
    many = [i for i, row in enumerate(cells, 1) if any(row[2 + 3 * count :])]
    require(not many, f"{count} markers, but rows {many[:5]} have more cells")
    values = [
        [float(x) if x.strip() else np.nan for x in row[2 : 2 + 3 * count]]
        for row in cells
    ]
    points = unit * np.array(values).reshape(len(rows), count, 3)
    seconds = np.array([float(row[1]) for row in cells])
    return Trc(names, points, seconds, float(header["DataRate"]), rows)


def _file_facts(outcome: Outcome, of: str | None) -> dict[str, Any]:
    """Return frames, fps, duration and markers of a written file."""
    path = outcome.file(of)
    if path.suffix == ".trc":
        trc = read_trc(path)
        length = float(trc.seconds[-1] - trc.seconds[0])
        facts = {"frames": len(trc.rows), "fps": trc.rate, "duration": length}
        unnamed = sum(not name for name in trc.names)
        return {**facts, "markers": len(trc.names), "unlabelled": unnamed}
    if path.suffix == ".c3d":
        c3d = read_c3d(path.read_bytes())
        frames, markers = c3d.points.shape[:2]
        facts = {"frames": frames, "fps": c3d.rate, "duration": (frames - 1) / c3d.rate}
        return {**facts, "markers": markers}
    if path.suffix == ".bvh":
        bvh = read_reference(path)
        length = (len(bvh.rows) - 1) * bvh.frame_time
        return {"frames": len(bvh.rows), "fps": 1 / bvh.frame_time, "duration": length}
    require(path.suffix in {".usd", ".usda", ".usdc"}, f"{path.name} is not read here")
    clocked = open_clocked(path)
    length = (clocked.codes[-1] - clocked.codes[0]) / clocked.fps
    return {"frames": len(clocked.codes), "fps": clocked.fps, "duration": length}


def _fact(outcome: Outcome, key: str, of: str | None) -> Any:
    """Return what `info` says, else what is written."""
    facts = outcome.information if of is None else None
    facts = _file_facts(outcome, of) if facts is None else facts
    require(facts.get(key) is not None, f"no {key} is known")
    return facts[key]


def frames(outcome: Outcome, *, value: int, of: str | None = None) -> None:
    """Require a number of frames."""
    count = _fact(outcome, "frames", of)
    require(count == value, f"{count} frames, not {value}")


def fps(
    outcome: Outcome,
    *,
    value: float,
    tolerance: float | None = None,
    of: str | None = None,
) -> None:
    """Require a rate; files round theirs."""
    rate = _fact(outcome, "fps", of)
    tolerance = 1e-4 * value if tolerance is None else tolerance
    require(close(rate, value, tolerance), f"{rate} fps, not {value}")


def duration_s(
    outcome: Outcome, *, value: float, tolerance: float, of: str | None = None
) -> None:
    """Require the time from the first frame to the last."""
    length = _fact(outcome, "duration", of)
    require(close(length, value, tolerance), f"{length} s, not {value}")


def markers(outcome: Outcome, *, value: int, of: str | None = None) -> None:
    """Require a number of markers."""
    count = _fact(outcome, "markers", of)
    require(count == value, f"{count} markers, not {value}")


def unlabelled(outcome: Outcome, *, value: int, of: str | None = None) -> None:
    """Require a number of markers without a name."""
    count = _fact(outcome, "unlabelled", of)
    require(count == value, f"{count} unlabelled, not {value}")


def _written(outcome: Outcome, of: str | None) -> tuple[Floats, Floats, list[str]]:
    """Return points, their seconds from the first frame, and names of markers."""
    path = outcome.file(of)
    if path.suffix == ".c3d":
        c3d = read_c3d(path.read_bytes())
        return c3d.points, np.arange(len(c3d.points)) / c3d.rate, c3d.names
    require(path.suffix == ".trc", f"{path.name} has no markers that are read here")
    trc = read_trc(path)
    return trc.points, trc.seconds - trc.seconds[0], trc.names


def bounds_m(
    outcome: Outcome, *, value: Any, tolerance: float, of: str | None = None
) -> None:
    """Require the least and the most of each axis, over all frames and markers."""
    facts = outcome.information if of is None else None
    if facts is not None:
        bounds = UNITS[facts.get("units") or "m"] * np.array(facts["bounds"], float)
    else:
        points = _written(outcome, of)[0].reshape(-1, 3)
        require(np.isfinite(points).any(axis=0).all(), "no marker is anywhere")
        bounds = np.stack([np.nanmin(points, axis=0), np.nanmax(points, axis=0)])
    off = float(np.abs(bounds - np.asarray(value, float)).max())
    require(off <= tolerance, f"{np.round(bounds, 5).tolist()}, off by {off:.3g} m")


def height_m(
    outcome: Outcome, *, value: Any, tolerance: float, of: str | None = None
) -> None:
    """Require the range along the up axis, which may point down an axis."""
    facts = outcome.information if of is None else None
    if facts is None:
        positions = np.concatenate(
            [each.positions().reshape(-1, 3) for each in skeletons(outcome.file(of))]
        )
        least, most = positions[:, 1].min(), positions[:, 1].max()
    else:
        up = re.fullmatch(r"([+-]?)([XYZ])", str(facts.get("up")).strip().upper())
        require(up, f"the up axis is {facts.get('up')!r}")
        assert up is not None
        bounds = UNITS[facts.get("units") or "m"] * np.array(facts["bounds"], float)
        along = bounds[:, "XYZ".index(up[2])] * (-1.0 if up[1] == "-" else 1.0)
        least, most = along.min(), along.max()
    near = close(least, value[0], tolerance) and close(most, value[1], tolerance)
    require(near, f"heights {least:.5g} to {most:.5g} m, not {value[0]} to {value[1]}")


def max_step_m(outcome: Outcome, *, max: float, of: str | None = None) -> None:
    """Require that no marker moves farther in a frame."""
    points, _, _ = _written(outcome, of)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=2)
    require(np.isfinite(steps).any(), "no marker is seen in two frames")
    most = float(np.nanmax(steps))
    require(most <= max, f"a marker moves {most:.5g} m in a frame, at most {max}")


def marker_at(
    outcome: Outcome,
    *,
    marker: int | str,
    seconds: float,
    value: Any,
    tolerance: float,
    of: str | None = None,
) -> None:
    """Require where a marker is at a time from the first frame."""
    points, times, names = _written(outcome, of)
    known = isinstance(marker, int) or marker in names
    require(known, f"no marker {marker!r} among {names}")
    index = marker if isinstance(marker, int) else names.index(marker)
    require(index < len(names), f"{len(names)} markers, none of number {marker}")
    frame = int(np.abs(times - seconds).argmin())
    half = 0.5 * float(np.diff(times).min(initial=np.inf))
    late = abs(float(times[frame]) - seconds)
    require(late < half, f"no frame at {seconds} s, the nearest is {late:.3g} s off")
    point = points[frame, index]
    off = float(np.abs(point - np.asarray(value, float)).max())
    # What is not seen is off by no number.
    require(off <= tolerance, f"{np.round(point, 5).tolist()}, off by {off:.3g} m")


def trc_rows_end(outcome: Outcome, *, of: str | None = None) -> None:
    """Require that the last cell of a row is closed by a tab where it is empty."""
    path = outcome.file(of)
    trc = read_trc(path)
    cells = [row.split("\t") for row in path.read_text("utf-8").split("\n")[5:]]
    cells = [row for row in cells if any(map(str.strip, row))]
    last = 1 + 3 * len(trc.names)
    bare = [
        i
        for i, row in enumerate(cells, 1)
        if len(row) == last + 1 and not row[last].strip()
    ]
    require(not bare, f"rows {bare[:5]} end in an empty cell without a tab")


CHECKS = {
    "bounds_m": bounds_m,
    "duration_s": duration_s,
    "fps": fps,
    "frames": frames,
    "height_m": height_m,
    "marker_at": marker_at,
    "markers": markers,
    "max_step_m": max_step_m,
    "trc_rows_end": trc_rows_end,
    "unlabelled": unlabelled,
}
