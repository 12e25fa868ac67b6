"""Clips written and read again; captured motion as keys, baked, is the same motion."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bvh import COLUMNS, small_bvh
from support.cli import animtool
from support.clips import RIG, assert_same_clip, channel_of, loaded
from support.data import data_files

from animtool import compare
from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip, clip_text
from animtool.clip.file import load_clip, open_clip
from animtool.core.units import unit_name
from animtool.maths import so3
from animtool.maths.curves import Extrapolation, Interp
from animtool.maths.euler import ORDERS
from animtool.maths.tangents import Parametrization, Tangent
from animtool.rig.file import load_rig
from animtool.rig.skeleton import Rig

SAMPLES = sorted((Path(__file__).parents[2] / "samples").glob("*/*.clip.yaml"))
UNITS = list(itertools.product(("m", "cm", "in"), ("deg", "rad")))
# Components of their values; of rotations, those of Euler angles.
WIDTHS = {
    "control/grin": 1,
    "control/lean": 1,
    "joint/elbow_l.angle": 1,
    "joint/piston.slide": 1,
    "joint/piston.scale": 3,
    "joint/hips.translation": 3,
    "joint/wrist_l.local_translation": 3,
    "joint/hips.rotation": 3,
    "joint/chest.local_rotation": 3,
}
TURNING = (Interp.STEP, Interp.SLERP, Interp.SQUAD, Interp.SPLINE)
PARAMETRIZATIONS = st.sampled_from(Parametrization)
NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)


# A file may hold no others.
LETTERS = st.characters(exclude_categories=["Cc", "Cs"])


@st.composite
def channels(draw: Any, target: str) -> ClipChannel:
    """Draw a channel of a target, with all that a file can say of one."""
    rotates = target.endswith("rotation")
    quaternions = rotates and draw(st.booleans())
    width = 4 if quaternions else WIDTHS[target]
    times = sorted(draw(st.sets(NUMBERS, min_size=1, max_size=5)))
    count = len(times)

    def table(columns: int) -> np.ndarray:
        rows = st.lists(NUMBERS, min_size=columns, max_size=columns)
        return np.array(draw(st.lists(rows, min_size=count, max_size=count)))

    values = table(width)
    if quaternions:
        values = so3.align_signs(so3.normalize(values))
    # What shapes curves of numbers is refused on quaternions.
    tangent = st.just(Tangent.AUTO_CLAMPED) if quaternions else st.sampled_from(Tangent)
    tangents = tuple(draw(st.tuples(tangent, tangent)) for _ in range(count))
    free = np.array(tangents) == Tangent.FREE
    handles = np.abs(table(1 + width)), np.abs(table(1 + width))
    interps = TURNING if quaternions else sorted(set(Interp) - set(TURNING[1:]))
    return ClipChannel(
        target,
        np.array(times),
        values,
        tuple(draw(st.sampled_from(interps)) for _ in range(count)),
        tangents,
        -handles[0] * free[:, :1],
        handles[1] * free[:, 1:],
        np.zeros((count, 3)) if quaternions else table(3),
        Parametrization.UNIFORM if quaternions else draw(PARAMETRIZATIONS),
        draw(st.sampled_from(ORDERS)) if rotates and not quaternions else "",
        draw(st.sampled_from(Extrapolation)),
        draw(st.sampled_from(Extrapolation)),
    )


@st.composite
def clips(draw: Any) -> Clip:
    """Draw a clip of the hero."""
    targets = draw(st.lists(st.sampled_from(sorted(WIDTHS)), unique=True))
    rate = st.fractions(Fraction(1, 1000), 1000, max_denominator=100_000)
    ends = sorted(draw(st.tuples(NUMBERS, NUMBERS)))
    return Clip(
        draw(st.text(LETTERS, min_size=1, max_size=20)),
        draw(rate),
        Fraction(ends[0]),
        Fraction(ends[1]),
        tuple(draw(channels(target)) for target in targets),
    )


@pytest.fixture(scope="module")
def heroes(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Path, Rig]]:
    """The hero in every unit, each in a folder."""
    made = []
    for length, angle in UNITS:
        folder = tmp_path_factory.mktemp(f"{length}_{angle}")
        text = RIG.replace(
            "length: cm, angle: deg", f"length: {length}, angle: {angle}"
        )
        if angle == "rad":
            text = text.replace("swing: 40, twist: [-45, 45]", "swing: 1")
        (folder / "hero.rig.yaml").write_text(text, "utf-8")
        made.append((folder, load_rig(folder / "hero.rig.yaml")))
    return made


def written_and_read(clip: Clip, rig: Rig, folder: Path) -> Clip:
    path = folder / "again.clip.yaml"
    path.write_text(clip_text(clip, rig, "hero.rig.yaml"), "utf-8")
    return load_clip(open_clip(path), rig)


@pytest.mark.slow
@given(clip=clips(), unit=st.integers(0, len(UNITS) - 1))
def test_any_clip_comes_back(
    heroes: list[tuple[Path, Rig]], clip: Clip, unit: int
) -> None:
    folder, rig = heroes[unit]
    back = written_and_read(clip, rig, folder)
    assert_same_clip(back, clip)
    assert clip_text(back, rig, "r") == clip_text(clip, rig, "r")


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.parent.name)
def test_samples_come_back(path: Path, tmp_path: Path) -> None:
    file = open_clip(path)
    assert file.rig_path is not None
    rig = load_rig(file.rig_path)
    clip = load_clip(file, rig)
    assert_same_clip(written_and_read(clip, rig, tmp_path), clip)
    # Decimals of a person stay decimals in the unit of the rig.
    units = f"units: {{length: {unit_name(rig.meters_per_unit)}, angle: deg}}"
    assert units in clip_text(clip, rig, "r")


def test_a_number_that_no_degree_gives(tmp_path: Path) -> None:
    clip, rig = loaded(tmp_path, "- {target: control/grin, keys: [{t: 0, v: 0}]}")
    values = np.random.default_rng(0).normal(size=(100, 1))
    odd = channel_of(np.arange(100), values)
    angles = replace(clip, channels=(replace(odd, target="joint/elbow_l.angle"),))
    assert "units: {length: cm, angle: rad}" in clip_text(angles, rig, "r")
    assert_same_clip(written_and_read(angles, rig, tmp_path), angles)


def test_what_is_usual_is_left_out(tmp_path: Path) -> None:
    text = (
        "- {target: joint/elbow_l.angle, interp: linear, tangents: flat,\n"
        "   keys: [{t: 1, v: 10}, {t: 2.5, v: 40, interp: step, out: [1, 2]}]}"
    )
    clip, rig = loaded(tmp_path, text)
    assert clip_text(clip, rig, "r").split("channels:\n")[1] == (
        "- target: joint/elbow_l.angle\n"
        "  interp: linear\n"
        "  tangents: flat\n"
        "  keys:\n"
        "  - {t: 1, v: 10}\n"
        "  - {t: 2.5, v: 40, interp: step, out: [1, 2]}\n"
    )


def test_a_take_at_rest_is_a_clip_without_channels(tmp_path: Path) -> None:
    (tmp_path / "still.bvh").write_text(small_bvh(np.zeros((2, COLUMNS))))
    clip = tmp_path / "still.clip.yaml"
    assert animtool("convert", tmp_path / "still.bvh", clip).code == 0
    done = animtool("bake", clip, "-o", tmp_path / "still.usda")
    assert done.code == 0, done.stderr
    assert compare(tmp_path / "still.bvh", tmp_path / "still.usda").within(
        meters=1e-6, degrees=1e-3
    )


@pytest.mark.parametrize("tolerance", [("0.5mm", 5e-4), ("5mm", 5e-3)])
def test_the_walk_as_keys(
    walk: Path, tmp_path: Path, tolerance: tuple[str, float]
) -> None:
    clip = tmp_path / "walk.clip.yaml"
    done = animtool("convert", walk, clip, "--reduce", tolerance[0], "--format", "json")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)["reduction"]
    assert found["held"]
    assert found["error"]["meters"] <= tolerance[1]
    assert found["keys"] < found["samples"] / 2
    assert (tmp_path / "walk.rig.yaml").is_file()
    baked = animtool("bake", clip, "-o", tmp_path / "walk.usdc")
    assert baked.code == 0, baked.stderr
    assert compare(walk, tmp_path / "walk.usdc").within(meters=tolerance[1], degrees=90)


def test_an_existing_rig_is_not_overwritten(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "walk.rig.yaml").write_text("mine")
    done = animtool("convert", walk, tmp_path / "walk.clip.yaml")
    assert done.code == 2
    assert "OUT001" in done.stderr
    assert (tmp_path / "walk.rig.yaml").read_text() == "mine"
    assert not (tmp_path / "walk.clip.yaml").exists()


@pytest.mark.slow
@pytest.mark.parametrize("path", data_files("bvh", "pybvh_*.bvh"))
def test_captures_as_keys(path: Path, tmp_path: Path) -> None:
    clip = tmp_path / "take.clip.yaml"
    done = animtool("convert", path, clip, "--reduce", "2mm")
    assert done.code == 0, done.stderr
    baked = animtool("bake", clip, "-o", tmp_path / "take.usdc")
    assert baked.code == 0, baked.stderr
    found = compare(path, tmp_path / "take.usdc")
    assert found.within(meters=2e-3 + 1e-6, degrees=360)
