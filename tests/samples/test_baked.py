"""Every sample, baked in each form: valid, and UsdSkel plays it as animtool does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from support.cli import animtool
from support.suite import some_quick
from support.usd import joint_transforms, open_stage, skeleton_query, validation_errors

from animtool import open_source
from animtool.motion.take import Take
from animtool.rig.kinematics import forward_kinematics, rest_size

ROOT = Path(__file__).parents[2]
SAMPLES = sorted(
    path
    for path in ROOT.glob("samples/*/*")
    if path.name.endswith((".bvh", ".clip.yaml"))
)
# Of the skeleton's size, or how far it goes: what float32 leaves of joint places.
PLACES = 1e-6
# Of axes of unit length, turned by float32 quaternions down a chain.
TURNS = 1e-6
WEIGHTS = 1e-7


@dataclass(frozen=True, slots=True)
class Baked:
    """A sample as a take, and as stages by form."""

    take: Take
    stages: dict[str, Any]


@pytest.fixture(
    scope="module", params=some_quick(SAMPLES, 3), ids=lambda path: path.parent.name
)
def baked(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Baked:
    """A sample baked as one file, as three, and as a layer over the rig of these."""
    sample, folder = request.param, tmp_path_factory.mktemp("baked")
    whole, split = folder / "whole.usdc", folder / "split.usda"
    layer, rig = folder / "layer.usdc", folder / "split.rig.usda"
    for arguments in (
        ["-o", whole],
        ["-o", split, "--split"],
        ["-o", layer, "--as", "layer", "--rig-layer", rig],
    ):
        done = animtool("bake", sample, "--strict", *arguments)
        assert done.code == 0, done.stderr
        assert "warning" not in done.stderr.lower()
    shot = Usd.Stage.CreateInMemory()
    shot.GetRootLayer().subLayerPaths = [str(layer), str(rig)]
    for name in ("upAxis", "metersPerUnit", "timeCodesPerSecond", "defaultPrim"):
        shot.SetMetadata(name, open_stage(rig).GetMetadata(name))
    stages = {"stage": open_stage(whole), "split": open_stage(split), "layer": shot}
    return Baked(open_source(sample).collect(), stages)


def codes_of(baked: Baked, form: str) -> list[float]:
    """Return the time codes of samples; of a take at rest, which has none, all."""
    query = skeleton_query(baked.stages[form]).GetAnimQuery()
    return list(query.GetJointTransformTimeSamples()) or baked.take.clock.times.tolist()


FORMS = pytest.mark.parametrize("form", ["stage", "split", "layer"])


@FORMS
def test_it_is_valid(baked: Baked, form: str) -> None:
    assert validation_errors(baked.stages[form]) == []


@FORMS
def test_usdskel_puts_joints_where_we_do(baked: Baked, form: str) -> None:
    take, stage = baked.take, baked.stages[form]
    codes = codes_of(baked, form)
    assert len(codes) == take.clock.count
    translations, rotations, scales = take.motion.dense()
    if scales is not None:
        # UsdSkel has them as halves, of three digits.
        scales = scales.astype(np.float16).astype(np.float64)
    ours = forward_kinematics(take.rig, translations, rotations, scales)
    theirs = joint_transforms(stage, codes)
    order = [
        str(name).rsplit("/", 1)[-1] for name in skeleton_query(stage).GetJointOrder()
    ]
    places = [order.index(name) for name in take.rig.names]
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    size = max(rest_size(take.rig), float(np.abs(ours.positions).max()))
    np.testing.assert_allclose(
        theirs[:, places, 3, :3] * meters,
        ours.positions,
        rtol=0,
        atol=PLACES * size,
    )
    linear = theirs[:, places, :3, :3].swapaxes(-1, -2)
    np.testing.assert_allclose(linear, ours.linear, rtol=0, atol=TURNS)


@FORMS
def test_skeleton_space_is_placed_by_the_prim(baked: Baked, form: str) -> None:
    stage = baked.stages[form]
    query, codes = skeleton_query(stage), codes_of(baked, form)
    placed = joint_transforms(stage, codes)
    for code, world in zip(codes, placed, strict=True):
        cache = UsdGeom.XformCache(Usd.TimeCode(code))
        own = np.array(query.ComputeJointSkelTransforms(Usd.TimeCode(code)))
        above = np.array(cache.GetLocalToWorldTransform(query.GetPrim()))
        np.testing.assert_allclose(own @ above, world, rtol=0, atol=1e-12)


@FORMS
def test_shapes_have_our_weights(baked: Baked, form: str) -> None:
    take, stage = baked.take, baked.stages[form]
    query = skeleton_query(stage).GetAnimQuery()
    names = [str(name) for name in query.GetBlendShapeOrder()]
    if take.motion.weights is None:
        assert names == []
        return
    expected = take.motion.weights.dense()[:, :, 0]
    # Shapes that are never seen are left out.
    kept = [shape.name in names for shape in take.rig.shapes]
    assert not expected[:, ~np.array(kept)].any()
    expected = expected[:, kept]
    columns = [names.index(s.name) for s in take.rig.shapes if s.name in names]
    for code, weights in zip(codes_of(baked, form), expected, strict=True):
        found = np.array(query.ComputeBlendShapeWeights(Usd.TimeCode(code)))
        np.testing.assert_allclose(found[columns], weights, rtol=0, atol=WEIGHTS)


def test_the_animation_is_bound_below_the_root(baked: Baked) -> None:
    for stage in baked.stages.values():
        prim = skeleton_query(stage).GetAnimQuery().GetPrim()
        assert prim.IsA(UsdSkel.Animation)
        assert UsdSkel.Root.Find(prim)
