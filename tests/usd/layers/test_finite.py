"""No number reaches a USD file that its attribute's type holds as infinite."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Vt
from support.cli import animtool
from support.faults import raises

from animtool.core.array_types import FloatArray
from animtool.core.errors import OutputError
from animtool.maths.curves import cubic_curves, evaluate
from animtool.motion.motion import Channel, Motion
from animtool.rig.skeleton import Joint, Rig
from animtool.usd.caches.writer import CachedMesh, FrameBlock, PointWriter
from animtool.usd.layers.finite import ValueLabels, narrow_floats, round_to_float32
from animtool.usd.layers.sdf import SampleWriter, attribute_spec, new_layer, prim_spec
from animtool.usd.takes.joint_writer import round_blocks
from animtool.usd.takes.splines import author_curve

TYPES = Sdf.ValueTypeNames
RIG = """\
rig: animtool/1
name: hero
joints:
- {{name: hips, type: free}}
- {{name: hand, parent: hips, type: free, translate: [{x}, 0, 0]}}
- {{name: slide, parent: hand, type: prismatic, axis: [1, 0, 0]}}
- {{name: slide2, parent: slide, type: prismatic, axis: [1, 0, 0]}}
shapes: [{{name: smile}}]
controls:
- {{name: grin, drives: [{{shape: smile, expr: "{expr}"}}]}}
- {{name: reach, drives: [{{joint: slide.slide, expr: "{reach}"}},
                          {{joint: slide2.slide, expr: "{reach}"}}]}}
"""
CLIP = """\
clip: animtool/1
rig: hero.rig.yaml
fps: 24
range: [1, 3]
channels:
- {target: control/grin, keys: [{t: 1, v: 0}, {t: 3, v: 80}]}
- {target: control/reach, keys: [{t: 1, v: 0}, {t: 3, v: 80}]}
"""


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"expr": "exp(grin) * exp(grin)"}, "shape 'smile'"),
        ({"reach": "exp(reach) * exp(reach)"}, "joint 'slide'"),
        # Each of two joints is held, their sum is not.
        ({"reach": "reach * 3e36"}, "extent"),
    ],
)
def test_a_value_beyond_float32_is_refused_by_name(
    tmp_path: Path, given: dict[str, str], said: str
) -> None:
    parts = {"x": "1", "expr": "grin", "reach": "reach", **given}
    (tmp_path / "hero.rig.yaml").write_text(RIG.format(**parts))
    (tmp_path / "hero.clip.yaml").write_text(CLIP)
    done = animtool("bake", "hero.clip.yaml", "-o", "o.usda", cwd=tmp_path)
    assert done.code == 3
    assert "USD170" in done.stderr
    assert said in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "hero.clip.yaml",
        "hero.rig.yaml",
    ]


def motion(translations: FloatArray, scales: FloatArray | None = None) -> Motion:
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (*translations.shape[:2], 1))
    return Motion(
        Channel.from_dense(translations),
        Channel.from_dense(turns),
        None if scales is None else Channel.from_dense(scales),
    )


PAIR = Rig("pair", [Joint("hips", -1), Joint("hand", 0)])


@pytest.mark.parametrize(
    ("place", "scale", "said"),
    [
        (1e39, 1.0, "translations: joint 'hand' at frame 2 is 1e+39"),
        (np.nan, 1.0, "translations: joint 'hand' at frame 2 is nan"),
        (1.0, 7e4, "scales: joint 'hand' at frame 2 is 70000; float16"),
        (1.0, 65504.0, ""),
        (3.4e38, 1.0, ""),
    ],
)
def test_the_joint_and_the_frame_are_named(
    place: float, scale: float, said: str
) -> None:
    moves, scales = np.zeros((2, 2, 3)), np.ones((2, 2, 3))
    moves[1, 1, 1], scales[1, 1, 2] = place, scale
    blocks = round_blocks(
        iter([(np.array([1.0, 2.0]), motion(moves, scales))]), PAIR, 1.0
    )
    if said:
        with raises(OutputError, "USD170", match=re.escape(said)):
            list(blocks)
    else:
        assert np.isfinite(next(blocks).extents).all()


def test_a_unit_that_makes_a_number_too_large_is_seen() -> None:
    moves = np.zeros((1, 2, 3))
    moves[0, 0, 0] = 1e38
    blocks = round_blocks(iter([(np.ones(1), motion(moves))]), PAIR, 0.01)
    with raises(OutputError, "USD170", match=r"joint 'hips' at frame 1 is 1e\+40"):
        list(blocks)


def test_half_scales_that_are_too_small_become_zero() -> None:
    scales = np.full((1, 2, 3), 1e-9)
    blocks = round_blocks(
        iter([(np.ones(1), motion(np.zeros((1, 2, 3)), scales))]), PAIR, 1.0
    )
    block = next(blocks)
    assert block.scale_error == 1.0
    assert not np.asarray(block.scales).any()


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (TYPES.Float, 1e39),
        (TYPES.Float3, Gf.Vec3f(0, float("nan"), 0)),
        (TYPES.Half, 7e4),
        (TYPES.Double, float("inf")),
        (TYPES.Quatf, Gf.Quatf(float("nan"))),
        (TYPES.Matrix4d, Gf.Matrix4d(float("inf"))),
        (TYPES.Matrix4dArray, Vt.Matrix4dArray([Gf.Matrix4d(float("nan"))])),
        (TYPES.FloatArray, Vt.FloatArray([1, float("inf")])),
        (TYPES.Half3Array, [(1, 1, 1e5)]),
        (TYPES.TimeCode, Sdf.TimeCode(float("inf"))),
    ],
)
def test_a_default_that_is_not_finite_is_refused(kind: object, value: object) -> None:
    layer = new_layer(Path("o.usda"))
    spec = prim_spec(layer, "/a", "Xform")
    with raises(OutputError, "USD170", match=r"/a\.x: "):
        attribute_spec(spec, "x", kind, value)


def test_samples_of_any_attribute_are_checked() -> None:
    layer = new_layer(Path("o.usda"))
    spec = prim_spec(layer, "/a", "Xform")
    samples = SampleWriter(
        attribute_spec(spec, "x", TYPES.Float), lambda row: float(row[0])
    )
    samples.add(np.array([1.0]), np.array([[1.0]]))
    with raises(OutputError, "USD170", match=r"/a\.x: a value at frame 2 is 1e\+39"):
        samples.add(np.array([2.0]), np.array([[1e39]]))
    with raises(OutputError, "USD170", match="time code"):
        samples.add(np.array([np.inf]), np.array([[1.0]]))


def test_points_beyond_float32_are_named() -> None:
    points = np.zeros((2, 3, 3))
    points[1, 2, 0] = -1e39
    labels, codes = ValueLabels("points", "point"), np.array([1.0, 2.0])
    with raises(OutputError, "USD170", match=r"points: point 2 at frame 2 is -1e\+39"):
        round_to_float32(points, 1.0, labels, codes)
    points[1, 2, 0] = 3.3999999e38
    assert round_to_float32(points, 1.0, labels, codes)[0].max() < np.inf
    points[1, 2, 0] = np.nan
    with raises(OutputError, "USD170", match="nan"):
        round_to_float32(points, 1.0, labels, codes)
    with raises(OutputError, "USD170", match="point 1"):
        narrow_floats(np.array([[0.0], [1e39]]), "f", labels)


def test_a_frame_of_a_simulation_is_checked() -> None:
    layer = new_layer(Path("o.usda"))
    attribute_spec(prim_spec(layer, "/a", "Points"), "widths", TYPES.FloatArray)
    writer = PointWriter(layer, CachedMesh("/a"), writes_every_frame=True)
    widths = np.array([[1.0, np.inf]], np.float32)
    with raises(OutputError, "USD170", match=r"/a\.widths: point 1 at frame 4 is inf"):
        writer.add(FrameBlock(0, np.array([4.0]), {"widths": widths}, 2))


def test_a_spline_has_finite_numbers() -> None:

    ends, flat = np.array([[1.7e308], [-1.7e308]]), np.zeros((2, 1))
    curves = cubic_curves(np.array([0.0, 1.0]), ends, flat, np.array([[1e308], [0.0]]))
    layer = new_layer(Path("o.usda"))
    prim_spec(layer, "/a", "Xform")
    with np.errstate(all="ignore"), raises(OutputError, "USD170"):
        author_curve(layer, "/a", "x", curves, lambda t: evaluate(curves, t)[0])


def test_every_number_goes_through_the_gate(root: Path) -> None:
    """Only this module puts values into a layer by itself."""
    known = {"layers/sdf.py"}
    puts = re.compile(r"\bSetTimeSample\b|\.default = ")
    found = {
        path.relative_to(root / "animtool/usd").as_posix()
        for path in (root / "animtool/usd").rglob("*.py")
        if puts.search(path.read_text("utf-8"))
    }
    assert {name for name in found if not name.startswith("fixes/")} == known
