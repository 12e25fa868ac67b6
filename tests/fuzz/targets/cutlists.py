"""Timelines: planned as batches of their shots, and one shot as bake reads it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from support.timelines import clip, span, timeline

from animtool.batch.cut_frames import CutOptions
from animtool.batch.cuts import read_cut, read_cuts
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import MatchedFile
from animtool.core.values import plain_value
from fuzz.mutations import spoil, spoil_values

ABOUT = "timelines of OpenTimelineIO and cut lists (EDL), read to shots"

EDL = b"""TITLE: edit
FCM: NON-DROP FRAME

001  AX       V     C        00:00:01:00 00:00:03:12 01:00:00:00 01:00:02:12
* FROM CLIP NAME: walk
002  AX       V     D    012 00:00:00:00 00:00:02:00 01:00:02:12 01:00:04:12
M2   AX       048.0                00:00:00:00
* FROM CLIP NAME: walk
* TO CLIP NAME: run
FCM: DROP FRAME
003  AX       V     C        00:00:59;28 00:01:02;02 01:00:04;12 01:00:05;13
* FROM CLIP NAME: walk
M2   AX       -060.0               00:00:59;28
* FREEZE FRAME
004  BL       B     C        00:00:00;00 00:00:01;00 01:00:05;13 01:00:06;13
* FPS: 29.97
"""
RATES = [*[None] * 6, Fraction(24), Fraction(25), Fraction(30000, 1001), Fraction(30)]
TIMECODES = [*[None] * 6, "01:00:00:00", "00:00:00;00", "23:59:59:24"]


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    media = [folder / f"{name}.bvh" for name in ("walk", "run")]
    for path in media:
        path.touch()
    found = [MatchedFile(path, folder) for path in media]
    seeds = [_whole(folder), _plain(folder)]

    def run(rng: np.random.Generator) -> str:
        path = _written(rng, folder, seeds)
        fps = RATES[int(rng.integers(len(RATES)))]
        cut_start = int(rng.integers(2000)) if rng.integers(2) else None
        label = TIMECODES[int(rng.integers(len(TIMECODES)))]
        options = CutOptions(None, cut_start, int(rng.integers(9)), label, fps)
        try:
            cuts = read_cuts(path, found if rng.integers(2) else (), options)
            for cut in cuts.shots:
                assert cut.shot is not None
                assert cut.shot.cut_in <= cut.shot.cut_out
                assert all(isinstance(v, str) for v in cut.shot_values.values())
                json.dumps(plain_value(cut.shot), allow_nan=False)
                assert math.isfinite(float(cut.shot.media_in))
            if rng.integers(4) == 0:
                read_cut(path, "walk", CutOptions())
        except AnimtoolError as error:
            return error.code
        return f"{min(len(cuts.shots), 3)} shots"

    return run


def _whole(folder: Path) -> bytes:
    """Return a timeline with everything that is looked at."""
    import opentimelineio as otio

    first = clip("walk", "walk.bvh", (10, 20))
    first.effects.append(otio.schema.LinearTimeWarp(time_scalar=0.5))
    first.metadata["animtool"] = {"start_frame": 1001, "handles": 4}
    second = clip("run", f"file://{folder}/run.bvh", span(0, 30, 30), span(0, 90, 30))
    time = otio.opentime.RationalTime
    fade = otio.schema.Transition("fade", "SMPTE_Dissolve", time(3, 24), time(4, 24))
    nested = otio.schema.Stack("more")
    inner = otio.schema.Track("V2", kind="Video")
    inner.append(clip("walk", "walk.bvh", (0, 5)))
    nested.append(inner)
    nested.source_range = span(1, 4)
    nested.effects.append(otio.schema.LinearTimeWarp(time_scalar=2.0))
    still = clip("run", "run.bvh", (3, 6))
    still.effects.append(otio.schema.FreezeFrame())
    still.metadata["animtool"] = {"cut_start": 9, "first_timecode": "00:00:00:01"}
    off = otio.schema.Track("V3", children=[clip("walk", "walk.bvh", (0, 5))])
    off.enabled = False
    gap = otio.schema.Gap(source_range=span(0, 12))
    sound = otio.schema.Track("A1", kind="Audio")
    metadata = {"fps": 24, "handles": 2}
    path = folder / "whole.otio"
    items = (first, fade, second, gap, nested, still)
    timeline(path, *items, more=(sound, off), rate=24.0, metadata=metadata)
    return path.read_bytes()


def _plain(folder: Path) -> bytes:
    path = folder / "plain.otio"
    timeline(path, clip("walk", None, (0, 10)), clip("run", "run.bvh", (5, 10)))
    return path.read_bytes()


def _written(rng: np.random.Generator, folder: Path, seeds: list[bytes]) -> Path:
    """Write a timeline that is spoilt, by its bytes or by its values."""
    kind = rng.random()
    if kind < 0.25:
        path = folder / "edit.edl"
        path.write_bytes(spoil(rng, EDL))
        return path
    path = folder / "edit.otio"
    data = seeds[int(rng.integers(len(seeds)))]
    if kind < 0.45:
        data = spoil(rng, data)
    else:
        values = json.loads(data)
        for _ in range(int(min(rng.geometric(0.5), 3))):
            _set(rng, values)
        if rng.integers(2):
            values = spoil_values(rng, values)
        data = json.dumps(values).encode()
    if rng.random() < 0.02:
        deep = int(rng.choice([100, 1_000, 100_000]))
        data = b"[" * deep + data + (b"]" * deep if rng.integers(2) else b"")
    path.write_bytes(data)
    return path


NUMBERS: list[Any] = [
    *(0, -1, 1e-9, 1e9, 1e300, -1e300, float("nan"), float("inf"), 0.5, 2**53, 23.976),
]
URLS = [
    *("", "file://host/walk.bvh", "file://[", "file:///%00", "a%00b", "a\0b", "/", "."),
    *("../../../../etc/passwd", "/dev/zero", "http://[::1", "//host/a", "walk%2ebvh"),
    *("file:", "a" * 5000, "\ud800", "~/.profile", "C:\\walk.bvh", "file://localhost/"),
]


def _set(rng: np.random.Generator, values: object) -> None:
    """Set one of the values that count, wherever it is."""
    keys = ["value", "rate", "time_scalar", "target_url", "name", "enabled"]
    chosen = str(rng.choice(keys))
    holders = [holder for holder in _tables(values) if chosen in holder]
    if not holders:
        return
    holder = holders[int(rng.integers(len(holders)))]
    pool: list[Any] = NUMBERS
    if chosen in {"target_url", "name"}:
        pool = URLS
    if chosen == "enabled":
        pool = [True, False]
    holder[chosen] = pool[int(rng.integers(len(pool)))]


def _tables(value: object) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    if isinstance(value, dict):
        found.append(value)
    inner = value.values() if isinstance(value, dict) else value
    if isinstance(inner, list) or isinstance(value, dict):
        for part in inner:  # type: ignore[attr-defined]
            found += _tables(part)
    return found
