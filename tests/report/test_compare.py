from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Sdf, Vt
from support.bvh import SPINE, random_rows, small_bvh
from support.drifting import author_samples

from animtool.core.errors import OptionError
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.report.compare import (
    SCALE_TOLERANCE,
    TakeDifference,
    compare,
    compare_takes,
)
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import SourceOptions


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "take.bvh"
    path.write_text(small_bvh(random_rows(8)))
    return path


@pytest.fixture
def take(path: Path) -> Take:
    return read_bvh(path).collect()


def moved(take: Take, **channels: Channel) -> Take:
    return replace(take, motion=replace(take.motion, **channels))


def test_a_known_slide_and_turn(take: Take) -> None:
    translations, rotations = (
        take.motion.translations.dense(),
        take.motion.rotations.dense(),
    )
    translations[5, 0, 1] += 0.25
    slid = compare_takes(
        take, moved(take, translations=Channel.from_dense(translations))
    )
    assert_allclose([slid.world.value, slid.translation.value], 0.25)
    assert slid.rotation.value == 0
    assert slid.world.code == 6
    rotations[2, 1] = so3.multiply(
        rotations[2, 1], so3.from_axis_angle([0.0, 1.0, 0.0], 0.5)
    )
    turned = compare_takes(take, moved(take, rotations=Channel.from_dense(rotations)))
    assert_allclose(turned.rotation.value, np.degrees(0.5))
    assert (turned.rotation.joint, turned.rotation.code) == ("Spine", 3)
    assert turned.world.value == 0  # nothing hangs below the spine


def test_scales_move_what_hangs_below(take: Take) -> None:
    scales = np.ones((8, 2, 3))
    scales[4, 0] = 2.0
    found = compare_takes(take, moved(take, scales=Channel.from_dense(scales)))
    assert_allclose(found.world.value, 0.01 * np.linalg.norm(SPINE))
    assert (found.scale.value, found.scale.joint) == (1.0, "Hips")
    assert not found.within(1.0, 1.0)
    leaf = np.ones((8, 2, 3))
    leaf[:, 1] = 3.0
    found = compare_takes(take, moved(take, scales=Channel.from_dense(leaf)))
    assert found.world.value == 0
    assert not found.within(1.0, 1.0)


@pytest.mark.parametrize(
    ("kind", "tolerances"),
    [
        ("world", (0.25, 1.0, 1.0)),
        ("translation", (0.25, 1.0, 1.0)),
        ("rotation", (1.0, 0.25, 1.0)),
        ("weight", (1.0, 1.0, 0.25)),
        ("scale", (1.0, 1.0, 1.0)),
    ],
)
def test_each_difference_counts_beyond_its_tolerance(
    take: Take, kind: str, tolerances: tuple[float, float, float]
) -> None:
    """A difference as large as the tolerance is none."""
    same = compare_takes(take, take)
    assert same.within(0.0, 0.0, 0.0)
    most = 1e-3 if kind == "scale" else 0.25
    for value, within in ((most, True), (np.nextafter(most, 1.0), False)):
        largest = replace(getattr(same, kind), value=value)
        found = replace(same, **{kind: largest})
        assert bool(found.within(*tolerances)) is within


def test_other_rates_and_lengths_are_mismatches(take: Take) -> None:
    slower = replace(take, clock=replace(take.clock, fps=Fraction(15)))
    found = compare_takes(take, slower)
    assert found.mismatches[0].startswith("30 fps instead of 15;")
    shorter = replace(
        take,
        clock=replace(take.clock, count=7),
        motion=take.motion.select(slice(0, 7)),
    )
    (text,) = compare_takes(take, shorter).mismatches
    assert "8 frames (1 to 8)" in text
    assert "7 (1 to 7)" in text


def test_time_codes_are_those_of_the_first(take: Take) -> None:
    values = take.motion.translations.dense()
    values[3, 0] += 1.0
    other = moved(take, translations=Channel.from_dense(values))
    late = replace(other, clock=replace(other.clock, start=Fraction(1001)))
    assert compare_takes(take, late).world.code == 4
    assert compare_takes(late, take).world.code == 1004


def test_another_first_time_code_is_a_note(path: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one.usda", tmp_path / "two.usda"
    for output, start in ((one, 1), (two, 1001)):
        bake(path, output, BakeOptions(start=Fraction(start)))
    found = compare(one, two)
    assert found.within(0.0, 0.0)
    assert found.mismatches == []
    assert found.notes == ["first time code 1 instead of 1001; compared from there"]


def test_each_file_has_options_of_its_own(path: Path, tmp_path: Path) -> None:
    bake(path, tmp_path / "o.usda", BakeOptions(prim_path="/World/a"))
    chosen = SourceOptions(prim_path="/World/a")
    assert compare(path, tmp_path / "o.usda", None, chosen).within(1e-6, 1e-4)
    with pytest.raises(OptionError) as caught:
        compare(path, tmp_path / "o.usda", chosen, chosen)
    assert caught.value.code == "CLI004"


def test_other_units_and_up_axis_are_the_same_take(path: Path, tmp_path: Path) -> None:
    options = BakeOptions(to_units=LengthUnit.M, to_up=UpAxis.Z)
    bake(path, tmp_path / "o.usdc", options)
    found = compare(path, tmp_path / "o.usdc")
    assert found.within(1e-6, 1e-4)
    in_metres = compare(path, tmp_path / "o.usdc", SourceOptions(unit=LengthUnit.M))
    assert in_metres.world.value > 1.0


def test_what_is_as_far_as_a_tolerance_is_within_it(take: Take) -> None:
    same = compare_takes(take, take)
    assert same.within(0.0, 0.0, 0.0)

    def apart(**values: float) -> TakeDifference:
        return replace(
            same, **{name: replace(getattr(same, name), value=value)
                     for name, value in values.items()},
        )  # fmt: skip

    limits = {"world": 0.5, "translation": 0.5, "rotation": 2.0, "weight": 0.25}
    assert apart(**limits, scale=SCALE_TOLERANCE).within(0.5, 2.0, 0.25)
    for name, limit in {**limits, "scale": SCALE_TOLERANCE}.items():
        beyond = apart(**{name: float(np.nextafter(limit, 1e3))})
        assert not beyond.within(0.5, 2.0, 0.25)
    assert not replace(same, mismatches=["a joint"]).within(1.0, 1.0)


def write_shot(folder: Path, name: str, characters: dict[str, float]) -> Path:
    """Write a stage of characters that refer to one take, each raised [m] at once."""
    take = author_samples(folder / "take.usda", [1.0, 2.0, 3.0, 4.0])
    layer = Sdf.Layer.CreateNew(str(folder / name))
    layer.timeCodesPerSecond = 24
    layer.pseudoRoot.SetInfo("metersPerUnit", 1.0)
    Sdf.CreatePrimInLayer(layer, "/World").specifier = Sdf.SpecifierDef
    for character, raised in characters.items():
        prim = Sdf.CreatePrimInLayer(layer, f"/World/{character}")
        prim.specifier = Sdf.SpecifierDef
        prim.referenceList.prependedItems = [Sdf.Reference(take.name, "/hero")]
        moved = Sdf.CreatePrimInLayer(layer, f"{prim.path}/Rig/Anim")
        attr = Sdf.AttributeSpec(moved, "translations", Sdf.ValueTypeNames.Float3Array)
        for time in (1.0, 4.0):
            rows = Vt.Vec3fArray([(0, raised, time), (0, 1, 0)])
            layer.SetTimeSample(attr.path, time, rows)
    layer.Save()
    return folder / name


def test_every_skeleton_is_compared(tmp_path: Path) -> None:
    one = write_shot(tmp_path, "one.usda", {"a": 0, "b": 0, "c": 0})
    two = write_shot(tmp_path, "two.usda", {"a": 0, "b": 0.25, "d": 0})
    found = compare(one, two)
    assert (found.skeletons, found.joints) == (2, 4)
    assert found.world.value == pytest.approx(0.25, rel=1e-6)
    assert found.world.skeleton == "/World/b/Rig/Skel"
    assert found.mismatches == [
        "1 skeleton is not in the second: /World/c/Rig/Skel",
        "1 skeleton is not in the first: /World/d/Rig/Skel",
    ]
    assert compare(one, one).within(0.0, 0.0)
    assert compare(one, one).skeletons == 3
    # One that is named is compared alone.
    named = compare(one, two, SourceOptions(prim_path="/World/a"))
    assert (named.skeletons, named.world.value) == (1, 0.0)
    assert named.notices == []


@pytest.mark.parametrize(("first_frame", "fits"), [(1, False), (9, True)])
def test_a_part_of_a_longer_take_is_found(
    walk: Path, first_frame: int, *, fits: bool
) -> None:
    take = read_bvh(walk).collect()
    first = first_frame - 1
    part = replace(
        take,
        clock=replace(take.clock, count=24, start=Fraction(1009)),
        motion=take.motion.select(slice(first, first + 24)),
    )
    for pair in ((take, part), (part, take)):
        found = compare_takes(*pair)
        assert ["9-32" in note for note in found.notes] == [True] * fits
        (mismatch,) = found.mismatches
        assert "(1009 to 1032)" in mismatch
    other = replace(part, motion=take.motion.select(slice(0, 24)))
    values = other.motion.rotations.dense() * [1, 1, 1, -1]
    other = moved(other, rotations=Channel.from_dense(values))
    assert not compare_takes(take, other).notes
