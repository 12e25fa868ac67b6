"""The nasty character through bake, convert and read, as USD itself has it."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Usd, UsdGeom, UsdSkel
from support.cli import animtool
from support.nasty import (
    START,
    TINY,
    bind_world,
    nasty_rig,
    nasty_stage,
    nasty_take,
    write_nasty_rig,
)
from support.usd import joint_transforms, open_stage, skeleton_query, validation_errors

from animtool.motion.motion import Channel
from animtool.motion.take import Take, TakeStream
from animtool.rig.skeleton import Rig
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import OpenTake
from animtool.usd.takes.read import read_usd


def baked(take: Take, output: Path, blocks: int = 1, **options: object) -> Any:
    """Bake a take that arrives in blocks; return the stage."""
    parts = np.array_split(np.arange(take.clock.count), blocks)
    stream = replace(TakeStream.of(take), blocks=map(take.motion.select, parts))
    source = output.with_suffix(".bvh")
    source.touch()
    bake(OpenTake(source, stream), output, BakeOptions(**options))  # type: ignore[arg-type]
    return open_stage(output)


def codes_of(take: Take) -> np.ndarray:
    return take.clock.times


def without_scales(take: Take) -> Take:
    return replace(take, motion=replace(take.motion, scales=None))


def test_root_motion_of_a_root_that_rests_turned_and_elsewhere(tmp_path: Path) -> None:
    take = without_scales(nasty_take())
    plain = baked(take, tmp_path / "plain.usda")
    moved = baked(take, tmp_path / "moved.usda", root_motion=True)
    codes = codes_of(take)
    one, two = (joint_transforms(stage, codes) for stage in (plain, moved))
    assert_allclose(one, two, atol=2e-5)
    world = take.world()
    assert_allclose(two[:, :, 3, :3], 100 * world.positions, atol=2e-5)
    assert_allclose(two[:, :, :3, :3].swapaxes(2, 3), world.linear, atol=2e-6)
    # The SkelRoot has all of it: the first root joint is at rest.
    query = skeleton_query(moved)
    for code in codes:
        posed = np.array(query.ComputeJointLocalTransforms(code))
        rest = np.array(query.ComputeJointLocalTransforms(code, atRest=True))
        assert_allclose(posed[0], rest[0], atol=1e-5)
    back = read_usd(tmp_path / "moved.usda").collect()
    assert_allclose(back.world().positions, world.positions, atol=1e-6)
    assert back.clock == take.clock


def bind_of(stage: Any) -> np.ndarray:
    """Return bind transforms of a stage's one skeleton, column vectors [cm]."""
    query = skeleton_query(stage)
    found = np.array(query.GetSkeleton().GetBindTransformsAttr().Get())
    return found.swapaxes(1, 2)


def in_centimetres(matrices: np.ndarray) -> np.ndarray:
    found = matrices.copy()
    found[:, :3, 3] *= 100
    return found


def test_a_bind_pose_that_is_turned_is_baked_and_comes_back(tmp_path: Path) -> None:
    rig = nasty_rig()
    stage = baked(nasty_take(), tmp_path / "take.usda")
    assert_allclose(bind_of(stage), in_centimetres(bind_world(rig)), atol=1e-9)
    assert validation_errors(stage) == []
    back = Rig.load(tmp_path / "take.usda")
    assert_allclose(bind_world(back), bind_world(rig), atol=1e-9)
    assert_allclose(back.rest_rotations, rig.rest_rotations, atol=1e-9)


def test_a_bind_pose_that_is_turned_is_converted_there_and_back(tmp_path: Path) -> None:
    rig = Rig.load(write_nasty_rig(tmp_path))
    done = animtool("convert", "nasty.rig.yaml", "rig.usda", cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert_allclose(
        bind_of(open_stage(tmp_path / "rig.usda")),
        in_centimetres(bind_world(rig)),
        atol=1e-9,
    )
    (tmp_path / "back").mkdir()
    done = animtool("convert", "rig.usda", "back/nasty.rig.yaml", cwd=tmp_path)
    assert done.code == 0, done.stderr
    back = Rig.load(tmp_path / "back/nasty.rig.yaml")
    assert back.bind == rig.bind
    assert back.joints == rig.joints


@pytest.mark.parametrize("name", ["rider", "horse"])
def test_extents_hold_every_skeleton_of_a_root(tmp_path: Path, name: str) -> None:
    pair = nasty_stage(tmp_path / "pair.usda")
    source = tmp_path / "source.usda"
    stage = Usd.Stage.Open(str(pair))
    if name == "horse":
        stage.RemovePrim("/World/pair_2/Rig/rider")
        stage.RemovePrim("/World/pair_2/Rig/rider_Body")
        stage.RemovePrim("/World/pair_2/Rig/rider_Anim")
    stage.Export(str(source))
    options = BakeOptions(rig_layer=pair, prim_path=f"/World/pair_2/Rig/{name}")
    bake(source, tmp_path / "over.usda", options)
    shot = Usd.Stage.CreateInMemory()
    shot.SetTimeCodesPerSecond(stage.GetTimeCodesPerSecond())
    shot.GetRootLayer().subLayerPaths = [str(tmp_path / "over.usda"), str(pair)]
    root = UsdGeom.Boundable(shot.GetPrimAtPath("/World/pair_2/Rig"))
    times = root.GetExtentAttr().GetTimeSamples()
    assert len(times) >= 5
    for time in times:
        computed = UsdGeom.Boundable.ComputeExtentFromPlugins(root, time)
        assert root.GetExtentAttr().Get(time) == computed


def test_samples_beyond_the_ends_hold_the_ends(tmp_path: Path) -> None:
    take = without_scales(nasty_take())
    offsets = (Fraction(-2, 7), Fraction(0), Fraction(3, 7))
    stage = baked(take, tmp_path / "fine.usda", samples=offsets)
    anim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Animation))
    attr = anim.GetAttribute("translations")
    codes = [float(START + k + o) for k in range(11) for o in offsets]
    assert_allclose(attr.GetTimeSamples(), codes, rtol=0, atol=1e-9)
    rows = np.array([attr.Get(code) for code in attr.GetTimeSamples()])[:, 0]
    assert_array_equal(rows[0], rows[1])
    assert_array_equal(rows[-1], rows[-2])
    assert (np.abs(np.diff(rows[1:-1], axis=0)).max(axis=1) > 0).all()
    places = 100 * take.motion.translations.dense()[:, 0]
    assert_allclose(rows[1::3], places, rtol=1e-6)
    between = places[:-1] + 3 / 7 * np.diff(places, axis=0)
    assert_allclose(rows[2:-1:3], between, rtol=1e-6)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (
        float(START),
        float(START + 10),
    )


@pytest.mark.parametrize("blocks", [1, 4])
def test_motion_of_a_ten_millionth_is_sampled(tmp_path: Path, blocks: int) -> None:
    take = without_scales(nasty_take())
    rig, motion = take.rig, take.motion
    still = motion.translations.rest[None].repeat(take.clock.count, axis=0)
    hand = rig.index("hand.R")
    still[:, hand] = rig.rest_translations[hand]
    # Some steps of float32 beside 30 cm.
    still[:, hand, 0] += TINY * np.sin(np.arange(take.clock.count) / 5)
    moving = Channel.from_dense(still)
    assert moving.animated.tolist() == [hand]
    assert_array_equal(moving.compact().dense(), still)
    assert motion.weights is not None
    take = replace(take, motion=replace(motion, translations=moving))
    stage = baked(take, tmp_path / "tiny.usda", blocks)
    anim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Animation))
    attr = anim.GetAttribute("translations")
    rows = np.array([attr.Get(code) for code in codes_of(take)])
    assert len(attr.GetTimeSamples()) == take.clock.count
    assert_allclose(rows[:, hand, 0], 100 * still[:, hand, 0], rtol=0, atol=1e-6)
    assert len(np.unique(rows[:, hand, 0])) > 3
    back = read_usd(tmp_path / "tiny.usda").collect()
    assert back.motion.translations.animated.tolist() == [hand]
    assert back.motion.weights is not None
    assert back.motion.weights.animated.tolist() == [0, 1]
    assert_allclose(
        back.motion.weights.dense(), motion.weights.dense(), rtol=1e-6, atol=0
    )
