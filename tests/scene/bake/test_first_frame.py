"""Takes of one rate on stages of another, brought in by every kind of arc."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Sdf, Usd
from support.cli import animtool
from support.drifting import author_samples
from support.suite import some_quick

from animtool.core.clock import Clock
from animtool.core.rates import parse_rate
from animtool.scene.bake.first_frame import integer_frames, start_frame_at_rate
from animtool.usd.takes.read import read_usd

FIRST, FRAMES = 1001, 24


def shot(folder: Path, own: float, stage_rate: float, arc: str) -> Path:
    """Write a take of one rate, and a stage of another that brings it in."""
    times = [float(FIRST + i) for i in range(FRAMES)]
    take = author_samples(folder / "take.usda", times, own)
    layer = Sdf.Layer.CreateNew(str(folder / "shot.usda"))
    layer.timeCodesPerSecond = layer.framesPerSecond = stage_rate
    if arc == "sublayer":
        layer.subLayerPaths = [take.name]
    else:
        world = Sdf.CreatePrimInLayer(layer, "/World/hero")
        world.specifier = world.nameParent.specifier = Sdf.SpecifierDef
        if arc == "payload":
            world.payloadList.prependedItems = [Sdf.Payload(take.name, "/hero")]
        else:
            offset = Sdf.LayerOffset(7.0 if arc == "offset" else 0.0)
            reference = Sdf.Reference(take.name, "/hero", offset)
            world.referenceList.prependedItems = [reference]
    layer.Save()
    return folder / "shot.usda"


def hips(path: Path) -> tuple[list[float], np.ndarray]:
    """Return the time codes and the hips' places of a written stage."""
    stage = Usd.Stage.Open(str(path))
    prim = next(p for p in stage.Traverse() if p.GetTypeName() == "SkelAnimation")
    attr = prim.GetAttribute("translations")
    times = attr.GetTimeSamples()
    return times, np.array([attr.Get(time)[0] for time in times])


@pytest.mark.parametrize(
    "arc", some_quick(["reference", "payload", "sublayer", "offset"], 2, 1)
)
@pytest.mark.parametrize(
    ("own", "stage_rate"),
    [
        *(("25", "24"), ("24", "25"), ("30", "24"), ("24", "30"), ("25", "30")),
        *(("48", "24"), ("24", "23.976"), ("23.976", "24"), ("24000/1001", "24")),
        *(("30000/1001", "25"), ("25", "30000/1001"), ("29.97", "23.976")),
    ],
)
def test_a_take_at_its_own_rate_keeps_its_samples(
    own: str, stage_rate: str, arc: str, tmp_path: Path
) -> None:
    rates = (float(Fraction(own)), float(Fraction(stage_rate)))
    path = shot(tmp_path, *rates, arc)
    output = tmp_path / "out.usda"
    done = animtool("bake", path, "-o", output, "--fps", own)
    assert done.code == 0, done.stderr
    times, places = hips(output)
    _, expected = hips(tmp_path / "take.usda")
    assert_allclose(times, times[0] + np.arange(FRAMES), atol=0)
    assert times[0] == int(times[0])
    assert_allclose(places, expected, atol=1e-6)
    start = read_usd(path).start
    if arc != "offset" and start is not None and start.denominator != 1:
        assert times[0] == FIRST
        assert done.stderr.count("TAKE008") == 1


def test_the_stage_s_own_rate_has_its_whole_frames(tmp_path: Path) -> None:
    path = shot(tmp_path, 25, 24, "reference")
    output = tmp_path / "out.usda"
    done = animtool("bake", path, "-o", output, "--fps", "24")
    assert done.stderr.count("TAKE008") == 1
    assert "TAKE006" in done.stderr
    times, places = hips(output)
    # 960.96 to 983.04 of the stage.
    assert times == [float(t) for t in range(961, 984)]
    exact = np.sin(np.array(times) * 25 / 24 / 10)
    assert_allclose(places[:, 0], exact, atol=2e-3)


def test_samples_are_kept_at_their_times(tmp_path: Path) -> None:
    path = shot(tmp_path, 25, 24, "reference")
    output = tmp_path / "out.usda"
    options = ("--fps", "25", "--keep-samples")
    assert animtool("bake", path, "-o", output, *options).code == 0
    assert hips(output)[0] == [float(FIRST + i) for i in range(FRAMES)]
    assert animtool("bake", path, "-o", output, "--overwrite").code == 0
    assert_allclose(hips(output)[0], (FIRST + np.arange(FRAMES)) * 0.96, atol=1e-9)


def test_a_whole_start_keeps_its_number() -> None:
    assert start_frame_at_rate(Fraction(1000), Fraction(24), parse_rate("25")) == 1000
    assert start_frame_at_rate(
        Fraction(24024, 25), Fraction(24), Fraction(24)
    ) == Fraction(24024, 25)
    # Far from a frame at the other rate: the nearest where whole ones are asked for.
    half = Fraction(97096, 100)
    assert start_frame_at_rate(half, Fraction(24), Fraction(25)) == 1011
    kept = start_frame_at_rate(half, Fraction(24), Fraction(25), is_rounded=False)
    assert kept == half * 25 / 24


def test_one_sample_a_frame_has_no_whole_frames() -> None:
    clock = Clock(Fraction(24), Fraction(3, 2), Fraction(1), 4)
    assert integer_frames(clock, Fraction(24), clock.start) is None
