"""Progress of bakes: it moves within long work, never falls, and ends at 1."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from support.sanitized import SANITIZED

from animtool import bake
from animtool.scene.bake import progress
from animtool.scene.bake.bake import bake_outputs
from animtool.scene.bake.progress import (
    BlockProgress,
    PeakMemory,
    ProgressPhases,
    TimeProgress,
)
from animtool.scene.file.read import load_scene

RIG = """\
rig: animtool/1
name: tail
joints:
- {name: body, type: free}
- {name: tail_1, type: ball, parent: body}
- {name: tail_2, type: ball, parent: tail_1, translate: [.2, 0, 0], tips: [[.2, 0, 0]]}
attach: [{name: tail, kind: spring_chain, joints: [tail_1, tail_2]}]
"""
CLIP = """\
clip: animtool/1
rig: tail.rig.yaml
fps: 24
range: [1, 12]
channels:
- {target: joint/body.translation, keys: [{t: 1, v: [0, 0, 0]}, {t: 12, v: [0, 0, 1]}]}
"""
SIMULATED = """\
scene: animtool/1
source: {file: tail.clip.yaml}
passes: [{simulate: {what: [tail], settle: 1}}]
"""
ROPE = """\
range: [1, 8]
systems:
- rope:
    from: [0, 1, 0]
    to: [.5, 1, 0]
    count: 6
    mass: 0.1
    springs: {structural: {axial_stiffness: 200, ratio: 0.1}}
    pins: [{particles: [start]}]
"""


def shares(folder: Path, scene: str) -> list[float]:
    """Bake a scene; return what it tells."""
    (folder / "tail.rig.yaml").write_text(RIG)
    (folder / "tail.clip.yaml").write_text(CLIP)
    path = folder / "s.scene.yaml"
    path.write_text(scene)
    told: list[float] = []
    bake(path, folder / "s.usdc", progress=told.append)
    return told


def check(told: list[float]) -> None:
    assert told[0] == 0
    assert told[-1] == 1
    assert told == sorted(told)


def test_a_simulate_pass_tells_while_it_holds_the_take(tmp_path: Path) -> None:
    told = shares(tmp_path, SIMULATED)
    check(told)
    # Frames of the take, and those in which it settles.
    assert len({*told}) >= 12 + 24 - 1
    assert told[len(told) // 2] == pytest.approx(0.5, abs=0.1)


def test_a_cycle_tells_its_repeats(tmp_path: Path) -> None:
    told = shares(tmp_path, SIMULATED.replace("settle: 1", "loop: true"))
    check(told)
    assert len({*told}) > 12


def test_two_passes_share_the_take(tmp_path: Path) -> None:
    twice = SIMULATED.replace("]\n", ", {simulate: {what: [tail], settle: 0}}]\n")
    told = shares(tmp_path, twice)
    check(told)
    assert sum(share > 0.5 for share in told) > 10


@pytest.mark.parametrize(
    "options",
    ["preroll: 4", "settle: true", "error: 0.01"],
)
def test_systems_tell_before_their_first_frame(tmp_path: Path, options: str) -> None:
    told = shares(tmp_path, f"scene: animtool/1\n{ROPE}    {options}\n")
    check(told)
    assert len({*told}) > 8 + 2


def test_systems_come_after_the_take(tmp_path: Path) -> None:
    text = SIMULATED + ROPE
    told = shares(tmp_path, text)
    check(told)
    assert sum(share > 0.5 for share in told) >= 8


def test_a_scene_of_several_outputs_tells_too(tmp_path: Path) -> None:
    shares(tmp_path, SIMULATED)
    path = tmp_path / "several.scene.yaml"
    path.write_text(f"{SIMULATED}output: [{{file: a.usda}}, {{file: a.clip.yaml}}]\n")
    told: list[float] = []
    bake_outputs(load_scene(path), progress=told.append)
    check(told)


def test_blocks_share_what_was_read() -> None:
    told: list[float] = []
    shown = BlockProgress(told.append, 1)
    tell = shown.of_pass(0)

    def blocks():
        for share in (0.25, 1.0):
            shown.read(share)
            tell(0.5)
            yield share

    assert len(list(shown.blocks(blocks()))) == 2
    assert told == [0.0, 0.125, 0.25, 0.625, 1.0]


def test_phases_take_half_of_what_is_left() -> None:
    told: list[float] = []
    phases = ProgressPhases(told.append)
    for tell in (phases.phase(), phases.phase(), phases.phase(is_last=True)):
        tell(1.0)
        tell(0.5)
    assert told == [0.5, 1.0]
    phases = ProgressPhases(told.append)
    told.clear()
    for is_last in (False, False, True):
        phases.phase(is_last=is_last)(1.0)
    assert told == [0.5, 0.75, 1.0]


def test_simulations_side_by_side_tell_their_mean() -> None:
    told: list[float] = []
    times = TimeProgress(told.append, 2.0)
    one, two = times.clock(-2.0), times.clock(0.0)
    one(0.0)
    two(1.0)
    assert told == [0.25, 0.5]


SIZE = 64_000_000


def test_nothing_is_known_before_it_begins() -> None:
    assert PeakMemory().peak_since_last_call() is None


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
@pytest.mark.skipif(SANITIZED, reason="sanitizers keep memory")
def test_each_peak_is_one_since_the_last() -> None:
    peak = PeakMemory()
    peak.begin()
    for _ in range(2):
        np.ones(SIZE // 8)
        assert (peak.peak_since_last_call() or 0) > 0.9 * SIZE
        assert (peak.peak_since_last_call() or 0) < 0.5 * SIZE


@pytest.mark.skipif(sys.platform == "win32", reason="no resource")
def test_systems_without_a_peak_of_their_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(progress, "_STATUS_PATH", str(tmp_path / "none"))
    peak = PeakMemory()
    peak.begin()
    assert (peak.base_bytes or 0) > 1_000_000
    assert (peak.peak_since_last_call() or 0) >= 0
    (tmp_path / "none").write_text("Name: python\n")
    assert peak.peak_since_last_call() is not None
    monkeypatch.setattr(sys, "platform", "win32")
    assert peak.peak_since_last_call() is None
