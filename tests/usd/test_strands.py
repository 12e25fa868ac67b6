"""Cloth and strands of a rig in USD: as UsdSkel moves them, and as they come back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt
from support.surfaces import held, shaped_rig
from support.usd import open_stage, validation_errors

from animtool.core.errors import FormatError
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.reorient import reorient
from animtool.motion.take import TakeStream
from animtool.rig.file import load_rig
from animtool.rig.kinematics import bind_world, forward_kinematics
from animtool.rig.parts import ArraySource, Attachment, LoadedArray
from animtool.rig.skeleton import Rig
from animtool.usd.rigs.layer import write_rig_layer
from animtool.usd.rigs.stored import read_rig_with_data

HAIR = "/hero/Rig/Strands/hair"


def haired_rig() -> Rig:
    """Return a rig with attachments of every kind, strands of two shapes."""
    rng = np.random.default_rng(5)
    attach = (
        Attachment("hair", "strands", ("hand",), points=held(rng.random((5, 4, 3)))),
        Attachment("tail", "spring_chain", ("arm.l", "hand")),
        Attachment(
            "cloak", "cloth", mesh="body", pins=LoadedArray(np.array([7.0, 2.0]))
        ),
        Attachment("bare", "cloth", mesh="Skel"),
        Attachment("a b", "strands", ("arm.l",), points=held(rng.random((1, 2, 3)))),
        Attachment("jelly", "soft", ("root",)),
    )
    return replace(shaped_rig(), attach=attach)


def values(source: ArraySource | None) -> list[Any] | None:
    return None if source is None else source.load().tolist()


def plain(attach: tuple[Attachment, ...]) -> list[tuple[Any, ...]]:
    """Return attachments with their numbers."""
    return [
        (a.name, a.kind, a.joints, a.mesh, values(a.pins), values(a.points))
        for a in attach
    ]


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_they_come_back_in_order(tmp_path: Path, suffix: str) -> None:
    rig, path = haired_rig(), tmp_path / f"hero.{suffix}"
    _, notices = write_rig_layer(rig, path)
    found, said = read_rig_with_data(path)
    assert notices == said == []
    assert plain(found.attach) == plain(rig.attach)
    assert validation_errors(open_stage(path)) == []


def test_units_of_the_layer_are_those_of_the_rig(tmp_path: Path) -> None:
    rig = replace(haired_rig(), meters_per_unit=0.01)
    write_rig_layer(rig, tmp_path / "x.usda")
    found, _ = read_rig_with_data(tmp_path / "x.usda")
    assert plain(found.attach) == plain(rig.attach)
    stage = open_stage(tmp_path / "x.usda")
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(HAIR))
    assert curves.GetWidthsAttr().Get()[0] == pytest.approx(0.04)
    assert_array_equal(
        curves.GetExtentAttr().Get(),
        UsdGeom.Boundable.ComputeExtentFromPlugins(curves, Usd.TimeCode.Default()),
    )


def test_usdskel_carries_them_with_their_joint(tmp_path: Path) -> None:
    rig = haired_rig()
    write_rig_layer(rig, tmp_path / "x.usda")
    stage = open_stage(tmp_path / "x.usda")
    root = UsdSkel.Root(stage.GetPrimAtPath("/hero/Rig"))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    queries = {str(q.GetPrim().GetPath()): q for q in binding.GetSkinningTargets()}
    query = queries[HAIR]
    assert query.IsRigidlyDeformed()
    turned = so3.multiply(so3.exp(np.array([0.3, -0.5, 0.2])), rig.rest_rotations)
    world, bind = (
        forward_kinematics(rig, rig.rest_translations[None], turned[None]),
        bind_world(rig),
    )
    rows = [
        np.block(
            [
                [w.linear[0, 2].T, np.zeros((3, 1))],
                [w.positions[0, 2][None], np.ones((1, 1))],
            ]
        )
        for w in (bind, world)
    ]
    moved = np.linalg.inv(rows[0]) @ rows[1]
    skinning = [Gf.Matrix4d(1.0)] * 3
    skinning[2] = Gf.Matrix4d(*moved.ravel().tolist())
    mapper = query.GetJointMapper()
    own = mapper.Remap(Vt.Matrix4dArray(skinning))
    checkpoint = np.array(query.ComputeSkinnedTransform(own))
    assert_allclose(checkpoint, moved, atol=1e-6)


def test_a_mesh_may_be_called_like_their_scope(tmp_path: Path) -> None:
    rig = haired_rig()
    cap = replace(rig.meshes[1], name="Strands")
    rig = replace(rig, meshes=(rig.meshes[0], cap), attach=rig.attach[:1])
    rig = replace(rig, shapes=rig.shapes[:3])
    write_rig_layer(rig, tmp_path / "x.usda")
    found, _ = read_rig_with_data(tmp_path / "x.usda")
    assert {mesh.name for mesh in found.meshes} == {"Strands", "body"}
    assert plain(found.attach) == plain(rig.attach)


def test_up_turns_strands_in_the_world() -> None:
    rig = haired_rig()
    stream = TakeStream(rig, Fraction(24), None, Fraction(1), iter(()))
    turned = reorient(stream, UpAxis.Z).rig.attach
    before, after = rig.attach[0].points, turned[0].points
    assert before is not None
    assert after is not None
    x, y, z = before.load().T
    assert_allclose(after.load().T, [x, -z, y], atol=1e-12)
    assert turned[1:4] == rig.attach[1:4]


def edited(tmp_path: Path, change: Callable[[Any], None]) -> tuple[Rig, list[str]]:
    """Return the rig of a layer that was changed, and the codes of what is said."""
    path = tmp_path / "x.usda"
    write_rig_layer(haired_rig(), path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    change(layer)
    layer.Save()
    rig, notices = read_rig_with_data(path)
    return rig, [notice.code for notice in notices]


def test_curves_that_are_gone_are_said(tmp_path: Path) -> None:
    def cut(layer: Any) -> None:
        del layer.GetPrimAtPath("/hero/Rig/Strands").nameChildren["hair"]

    rig, said = edited(tmp_path, cut)
    assert said == ["USD119"]
    assert [a.name for a in rig.attach] == ["tail", "cloak", "bare", "a b", "jelly"]


def test_a_mesh_that_is_gone_takes_its_cloth_along(tmp_path: Path) -> None:
    def cut(layer: Any) -> None:
        del layer.GetPrimAtPath("/hero/Rig").nameChildren["body"]

    rig, said = edited(tmp_path, cut)
    assert said == ["USD119"]
    assert [a.name for a in rig.attach] == ["hair", "tail", "bare", "a b", "jelly"]


@pytest.mark.parametrize("pins", [Vt.IntArray([1, 40]), Vt.FloatArray([0.5]), "all"])
def test_pins_that_the_mesh_lacks_are_said(tmp_path: Path, pins: Any) -> None:
    def change(layer: Any) -> None:
        spec = layer.GetPrimAtPath("/hero/Rig/Skel")
        data = dict(spec.customData["animtool"])
        spec.customData["animtool"] = {**data, "pins": {"cloak": pins}}

    rig, said = edited(tmp_path, change)
    assert said == ["USD119"]
    assert "cloak" not in [a.name for a in rig.attach]


def test_pins_that_are_no_mapping_are_refused(tmp_path: Path) -> None:
    def change(layer: Any) -> None:
        spec = layer.GetPrimAtPath("/hero/Rig/Skel")
        spec.customData["animtool"] = {**spec.customData["animtool"], "pins": 3}

    with pytest.raises(FormatError) as caught:
        edited(tmp_path, change)
    assert [fault.code for fault in caught.value.faults] == ["USD007"]


def test_combed_curves_count_as_they_are(tmp_path: Path) -> None:
    points = Vt.Vec3fArray([(k, 0, 0) for k in range(6)])

    def comb(layer: Any) -> None:
        layer.GetAttributeAtPath(f"{HAIR}.points").default = points
        layer.GetAttributeAtPath(f"{HAIR}.curveVertexCounts").default = Vt.IntArray(
            [3, 3]
        )

    rig, said = edited(tmp_path, comb)
    assert said == []
    assert values(rig.attach[0].points) == [
        [[k, 0, 0] for k in (0, 1, 2)],
        [[k, 0, 0] for k in (3, 4, 5)],
    ]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("curveVertexCounts", Vt.IntArray([8, 12])),
        ("curveVertexCounts", Vt.IntArray([4, 4])),
        ("curveVertexCounts", Vt.IntArray([1] * 20)),
        ("type", "cubic"),
        ("primvars:skel:jointIndices", Vt.IntArray([0, 0])),
    ],
)
def test_curves_that_are_no_strands_are_said(
    tmp_path: Path, name: str, value: Any
) -> None:
    def change(layer: Any) -> None:
        layer.GetAttributeAtPath(f"{HAIR}.{name}").default = value

    _, said = edited(tmp_path, change)
    assert said == ["USD119"]


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("points", Vt.Vec3fArray([(np.nan, 0, 0)] * 20), "USD265"),
        ("skel:joints", Vt.TokenArray(["elsewhere"]), "USD238"),
        ("primvars:skel:jointIndices", Vt.IntArray([4]), "USD230"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, name: str, value: Any, code: str
) -> None:
    def change(layer: Any) -> None:
        layer.GetAttributeAtPath(f"{HAIR}.{name}").default = value

    with pytest.raises(FormatError) as caught:
        edited(tmp_path, change)
    assert [fault.code for fault in caught.value.faults] == [code]


def test_a_sidecar_takes_strands_and_pins_a_mesh(tmp_path: Path) -> None:
    write_rig_layer(haired_rig(), tmp_path / "hero.usda")
    text = "rig: animtool/1\nname: hero\nfrom: hero.usda\nattach:\n"
    cloth = "- {name: cloak, kind: cloth, mesh: body, pins: pins.npz}\n"
    np.savez(tmp_path / "pins.npz", pins=np.array([39, 0]))
    path = tmp_path / "hero.rig.yaml"
    path.write_text(text + cloth, "utf-8")
    rig = load_rig(path)
    names = [entry.name for entry in rig.attach]
    assert names == ["hair", "tail", "bare", "a b", "jelly", "cloak"]
    assert rig.attach[-1].pins is not None
    assert rig.attach[-1].pins.load().tolist() == [39, 0]
    own = "- {name: hair, kind: spring_chain, joints: [hand]}\n"
    path.write_text(text + own, "utf-8")
    kinds = {entry.name: entry.kind for entry in load_rig(path).attach}
    assert kinds["hair"] == "spring_chain"
    assert kinds["cloak"] == "cloth"
    np.savez(tmp_path / "pins.npz", pins=np.array([40]))
    path.write_text(text + cloth, "utf-8")
    with pytest.raises(FormatError) as caught:
        load_rig(path)
    assert [fault.code for fault in caught.value.faults] == ["RIG027"]


def test_curves_of_another_tool_are_strands(tmp_path: Path) -> None:
    def forget(layer: Any) -> None:
        del layer.GetPrimAtPath("/hero/Rig/Skel").customData["animtool"]

    rig, said = edited(tmp_path, forget)
    assert said == []
    wanted = [entry for entry in haired_rig().attach if entry.points is not None]
    found = plain(rig.attach)
    assert [entry[4:] for entry in found] == [entry[4:] for entry in plain((*wanted,))]
    assert [entry[2] for entry in found] == [("hand",), ("arm_l",)]
