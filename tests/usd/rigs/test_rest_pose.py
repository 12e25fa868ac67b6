"""Skeletons without restTransforms: what stands in, and what nothing poses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Sdf, Usd
from support.cli import animtool
from support.drifting import author_samples

from animtool.core.errors import FormatError, Severity
from animtool.rig.skeleton import Rig
from animtool.usd.checks import check_layer
from animtool.usd.rigs.skinned import usdskel_world
from animtool.usd.takes.read import read_usd

SKELETON, ANIMATION = "/hero/Rig/Skel", "/hero/Rig/Anim"
TIMES = [1.0, 2.0, 3.0, 4.0]

Break = Callable[[Any], None]


def drop(*names: str) -> Break:
    def change(layer: Any) -> None:
        prim = layer.GetPrimAtPath(SKELETON)
        for name in names:
            prim.RemoveProperty(prim.properties[name])

    return change


def sparse(layer: Any) -> None:
    """Leave the animation its first joint alone."""
    drop("restTransforms")(layer)
    layer.GetAttributeAtPath(f"{ANIMATION}.joints").default = ["hips"]
    for name in ("translations", "rotations"):
        path = f"{ANIMATION}.{name}"
        for time in layer.ListTimeSamplesForPath(path):
            rows = layer.QueryTimeSample(path, time)
            layer.SetTimeSample(path, time, rows[:1])
    scales = layer.GetAttributeAtPath(f"{ANIMATION}.scales")
    scales.default = scales.default[:1]


def broken(folder: Path, change: Break) -> Path:
    path = author_samples(folder / "take.usda", TIMES)
    layer = Sdf.Layer.FindOrOpen(str(path))
    change(layer)
    layer.Save()
    return path


def codes(path: Path) -> dict[str, Severity]:
    found = check_layer(path)
    wanted = {"USD229", "USD239"}
    return {fault.code: fault.severity for fault in found if fault.code in wanted}


@pytest.mark.parametrize(
    "change",
    [drop("restTransforms"), drop("restTransforms", "bindTransforms")],
    ids=["bind", "first sample"],
)
def test_a_complete_animation_is_read_as_usd_poses_it(
    change: Break, tmp_path: Path
) -> None:
    path = broken(tmp_path, change)
    stream = read_usd(path)
    notices = [(notice.code, notice.severity) for notice in stream.notices]
    assert notices == [("USD229", Severity.WARNING)]
    assert codes(path) == {"USD229": Severity.WARNING}
    world = stream.collect().world().positions
    expected = usdskel_world(path, np.array(TIMES)).positions
    assert_allclose(world, expected, atol=1e-7)
    rest = stream.rig.rest_translations
    assert_allclose(rest[1], [0, 1, 0])
    output = tmp_path / "out.usda"
    assert animtool("bake", path, "-o", output).code == 0
    assert_allclose(
        usdskel_world(output, np.array(TIMES)).positions, expected, atol=1e-6
    )


@pytest.mark.parametrize("change", [sparse], ids=["sparse"])
def test_what_usd_does_not_pose_is_refused_alike(change: Break, tmp_path: Path) -> None:
    path = broken(tmp_path, change)
    with pytest.raises(FormatError) as caught:
        read_usd(path)
    assert caught.value.code == "USD239"
    assert "hips/knee" in str(caught.value)
    assert codes(path) == {"USD239": Severity.ERROR}


def test_nothing_to_take_a_rest_pose_from_is_refused(tmp_path: Path) -> None:
    path = broken(
        tmp_path, drop("restTransforms", "bindTransforms", "skel:animationSource")
    )
    with pytest.raises(FormatError) as caught:
        read_usd(path)
    assert caught.value.code == "USD239"
    assert codes(path) == {"USD239": Severity.ERROR}


@pytest.mark.parametrize(
    "change",
    [
        drop("restTransforms"),
        drop("restTransforms", "skel:animationSource"),
        sparse,
    ],
    ids=["animated", "alone", "sparse"],
)
def test_a_rig_rests_as_it_is_bound(change: Break, tmp_path: Path) -> None:
    rig = broken(tmp_path, change)
    take = author_samples(tmp_path / "source.usda", TIMES)
    layer = tmp_path / "layer.usda"
    done = animtool("bake", take, "--rig-layer", rig, "-o", layer)
    assert done.code == 0, done.stderr
    # Said once, and in our words alone.
    assert done.stderr.count("USD229") == 1
    assert "Warning: in" not in done.stderr
    assert_allclose(Rig.load(rig).rest_translations[1], [0, 1, 0])
    stage = Sdf.Layer.CreateAnonymous(".usda")
    stage.subLayerPaths = [str(layer), str(rig)]
    stage.pseudoRoot.SetInfo("metersPerUnit", 1.0)
    posed = tmp_path / "posed.usda"
    Usd.Stage.Open(stage).Flatten().Export(str(posed))
    times = np.array(TIMES)
    expected = usdskel_world(take, times).positions
    assert_allclose(usdskel_world(posed, times).positions, expected, atol=1e-6)


SKINNED = """\
#usda 1.0
(
    defaultPrim = "c"
    metersPerUnit = 1
    upAxis = "Y"
)
def SkelRoot "c"
{{
    def Skeleton "skel"
    {{
        uniform token[] joints = ["hip", "hip/knee", "hip/knee/foot"]
        uniform matrix4d[] bindTransforms = [{bind}]
        uniform matrix4d[] restTransforms = [{rest}]
    }}
}}
"""


def matrices(*heights: float) -> str:
    rows = "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, {}, 0, 1))"
    return ", ".join(rows.format(height) for height in heights)


@pytest.mark.parametrize(
    ("bind", "rest", "found"),
    [
        ((1, 1, 0.2), (1, -0.4, -0.4), True),
        ((1, 0.6, 0.6), (1, -0.4, -0.4), True),
        ((1, 0.6, 0.2), (1, -0.4, -0.4), False),
        ((1, 1, 0.2), (1, 0, -0.8), False),  # a helper joint at its parent
        ((100, 60, 20), (1, -0.4, -0.4), False),  # another unit
        ((1, 0.99, 0.2), (1, -0.4, -0.4), False),  # bound with another length
    ],
)
def test_a_bone_without_length_where_it_is_bound(
    bind: tuple[float, ...], rest: tuple[float, ...], found: bool, tmp_path: Path
) -> None:
    path = tmp_path / "a.usda"
    text = SKINNED.format(bind=matrices(*bind), rest=matrices(*rest))
    path.write_text(text, "utf-8")
    assert [fault.code for fault in check_layer(path)].count("USD290") == found
