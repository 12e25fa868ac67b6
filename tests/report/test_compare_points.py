"""Differences of points that systems show: ids, orientations, spaces, what is lost."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pxr import Usd, Vt
from support.cli import animtool

from animtool.report.compare_points import compare_points

BIRD = (
    '#usda 1.0\n(\n    metersPerUnit = 1\n)\ndef Mesh "bird" {\n'
    "point3f[] points = [(0, 0, 1), (1, 0, 0), (-1, 0, 0)]\n"
    "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n}\n"
)
SCENE = """\
scene: animtool/1
fps: 24
range: [1, 9]
systems:
- flocks:
    name: birds
    species:
    - name: bird
      count: 12
      shows: {file: bird.usda, prim: /bird}
- rope: {name: cord, from: [0, 1, 0], to: [1, 1, 0], count: 5, mass: 1,
    springs: {structural: {stiffness: 90}}}
"""
# What baked copies have an entry each of.
ARRAYS = (
    *("ids", "positions", "velocities", "orientationsf"),
    *("angularVelocities", "scales", "protoIndices"),
)


@pytest.fixture
def baked(tmp_path: Path) -> Path:
    (tmp_path / "bird.usda").write_text(BIRD, "utf-8")
    (tmp_path / "shot.scene.yaml").write_text(SCENE, "utf-8")
    return bake(tmp_path, "one")


def bake(folder: Path, name: str, *flags: object) -> Path:
    path = folder / f"{name}.usdc"
    assert animtool("bake", folder / "shot.scene.yaml", "-o", path, *flags).code == 0
    return path


def edited(path: Path, name: str, **changes: Any) -> Path:
    """Return a copy with attributes of the birds put through functions at frame 5."""
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath("/shot/birds")
    for key, change in changes.items():
        attribute = prim.GetAttribute(key)
        attribute.Set(change(attribute.Get(5)), 5)
    copy = path.with_name(f"{name}.usdc")
    stage.GetRootLayer().Export(str(copy))
    return copy


def test_other_spaces_and_files_are_the_same(baked: Path) -> None:
    for name, flags in (
        ("chunked", ("--chunk", 4)),
        ("other", ("--to-units", "cm", "--to-up", "Z")),
    ):
        found = compare_points(baked, bake(baked.parent, name, *flags))
        assert found is not None
        assert found.mismatches == []
        assert (found.prims, found.samples) == (2, 18)
        assert found.within(2e-6, 1e-4)
        assert len(found.notes) == (2 if name == "other" else 0)


def test_other_first_samples_are_noted(baked: Path) -> None:
    scene = baked.with_name("shot.scene.yaml")
    scene.write_text(SCENE.replace("[1, 9]", "[12, 20]"), "utf-8")
    found = compare_points(baked, bake(baked.parent, "late"))
    assert found is not None
    assert found.within(1e-9, 1e-9)
    assert found.notes == ["first time code 1 instead of 12; compared from there"]


def test_points_are_matched_by_their_ids(baked: Path) -> None:
    turned = edited(
        baked,
        "turned",
        ids=lambda ids: Vt.Int64Array(list(ids)[::-1]),
        positions=lambda rows: Vt.Vec3fArray(list(rows)[::-1]),
        orientationsf=lambda rows: Vt.QuatfArray(list(rows)[::-1]),
    )
    done = animtool("diff", baked, turned)
    assert (done.code, done.stdout.splitlines()[-1]) == (0, "same")
    moved = edited(
        baked,
        "moved",
        positions=lambda rows: Vt.Vec3fArray(
            [row + (type(row)(0, 0.5, 0) if i == 7 else 0 * row)
             for i, row in enumerate(rows)]
        ),
    )  # fmt: skip
    done = animtool("diff", baked, moved, "--format", "json")
    found = json.loads(done.stdout)
    assert (done.code, found["same"], found["kind"]) == (1, False, "points")
    assert found["points"] == {
        "value": pytest.approx(0.5), "prim": "birds", "point": 7, "code": 5.0
    }  # fmt: skip
    assert found["orientations"]["value"] == 0
    assert "point 7, time code 5" in animtool("diff", baked, moved).stdout
    assert animtool("diff", baked, moved, "--tolerance", "0.6").code == 0


def test_orientations_differ_by_an_angle(baked: Path) -> None:
    turned = edited(
        baked,
        "turned",
        orientationsf=lambda rows: Vt.QuatfArray(
            [type(row)(0, 1, 0, 0) * row if i == 3 else row
             for i, row in enumerate(rows)]
        ),
    )  # fmt: skip
    found = compare_points(baked, turned)
    assert found is not None
    assert found.points.value == 0
    largest = found.orientations
    assert (largest.value, largest.point) == (pytest.approx(180, abs=1e-3), 3)
    assert not found.within(1, 179)


def test_scales_differ_by_their_numbers(baked: Path) -> None:
    for more, same in ((5e-4, True), (0.25, False)):
        larger = edited(
            baked,
            "larger",
            scales=lambda rows, more=more: Vt.Vec3fArray(
                [row + type(row)(0, 0, more if i == 4 else 0)
                 for i, row in enumerate(rows)]
            ),
        )  # fmt: skip
        found = compare_points(baked, larger)
        assert found is not None
        assert (found.scales.value, found.scales.point) == (
            pytest.approx(more, 1e-3),
            4,
        )
        assert found.points.value == found.orientations.value == 0
        assert found.within(0, 0) is same


def test_copies_of_other_meshes_differ(baked: Path) -> None:
    other = edited(
        baked,
        "other",
        protoIndices=lambda rows: Vt.IntArray([1 if i == 2 else 0 for i in range(12)]),  # noqa: ARG005
    )
    found = compare_points(baked, other)
    assert found is not None
    assert found.mismatches == [
        "birds at time code 5: point 2 is a copy of mesh 0 instead of 1"
    ]


COPIES = """#usda 1.0
(
    defaultPrim = "shot"
)
def Xform "shot" {
    def PointInstancer "birds" {
        rel prototypes = [%(prototypes)s]
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 0, 0), (1, 0, 0)]
        %(more)s
        def Mesh "bird" {
            point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
            int[] faceVertexCounts = [3]
            int[] faceVertexIndices = [0, 1, 2]
        }
    }
}
"""


def copies(
    folder: Path, name: str, more: str = "", shown: str = "</shot/birds/bird>"
) -> Path:
    path = folder / f"{name}.usda"
    path.write_text(COPIES % {"prototypes": shown, "more": more}, "utf-8")
    return path


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ('string[] ids = ["a", "b"]', "USD269"),
        ("float[] ids = [nan, 1e30]", "USD269"),
        ('string[] orientations = ["a", "b"]', "USD269"),
        ("float3[] orientationsf = [(1, 0, 0), (0, 0, 0)]", "USD269"),
        ("quath[] orientations = [(0, 0, 0, 0), (1, 0, 0, 0)]", "USD288"),
        ("quath[] orientations = [(nan, 0, 0, 0), (1, 0, 0, 0)]", "USD288"),
        ('string[] scales = ["x", "y"]', "USD269"),
        ("float3[] scales = [(1, 1, 1)]", "USD269"),
        ("float3[] scales = [(1, nan, 1), (1, 1, 1)]", "USD265"),
        ("double3 xformOp:translate = (nan, 0, 0)\n"
         'uniform token[] xformOpOrder = ["xformOp:translate"]', "USD265"),
    ],
)  # fmt: skip
def test_copies_that_are_no_numbers_are_refused(
    tmp_path: Path, more: str, code: str
) -> None:
    done = animtool("diff", copies(tmp_path, "good"), copies(tmp_path, "bad", more))
    assert (done.code, code in done.stderr, "internal" in done.stderr) == (
        3, True, False,
    )  # fmt: skip


def test_what_copies_leave_out_changes_nothing(tmp_path: Path) -> None:
    stated = (
        "quatf[] orientationsf = [(1, 0, 0, 0), (-1, 0, 0, 0)]\n"
        "float3[] scales = [(1, 1, 1), (1, 1, 1)]"
    )
    found = compare_points(copies(tmp_path, "a"), copies(tmp_path, "b", stated))
    assert found is not None
    assert (found.samples, found.within(0, 0)) == (1, True)


def test_times_that_only_one_has_are_not_compared(tmp_path: Path) -> None:
    """The second ends at half of the first, of which it has every other frame."""
    paths = []
    for name, codes in (("a", range(1, 10)), ("b", range(1, 6, 2))):
        rows = ", ".join(f"{code}: [(0, {code}, 0), (1, 0, 0)]" for code in codes)
        path = copies(tmp_path, name)
        text = path.read_text("utf-8").replace(
            "positions = [(0, 0, 0), (1, 0, 0)]", f"positions.timeSamples = {{{rows}}}"
        )
        path.write_text(text, "utf-8")
        paths.append(path)
    found = compare_points(*paths)
    assert found is not None
    assert (found.samples, found.points.value) == (5, 0)
    (text,) = found.mismatches
    assert "9 samples (1 to 9)" in text
    assert "3 (1 to 5)" in text


def test_large_ids_are_told_apart(tmp_path: Path) -> None:
    ids = [f"int64[] ids = [{2**60}, {2**60 + last}]" for last in (1, 2)]
    one, two = (copies(tmp_path, f"{i}", text) for i, text in enumerate(ids))
    found = compare_points(one, two)
    assert found is not None
    assert found.mismatches == [
        f"birds at time code 0: the second file has no point with the id {2**60 + 1}"
    ]


@pytest.mark.parametrize("around", ["</shot/birds>", "</shot>"])
def test_copies_of_what_holds_them_are_copies(tmp_path: Path, around: str) -> None:
    path = copies(tmp_path, "self", shown=around)
    assert "USD287" in animtool("validate", path).stdout
    assert "copies" in animtool("info", path).stdout


def test_what_only_one_has_is_named(baked: Path, tmp_path: Path) -> None:
    gone = edited(
        baked,
        "gone",
        **dict.fromkeys(ARRAYS, lambda rows: rows[:9]),
    )
    found = compare_points(baked, gone)
    assert found is not None
    assert found.mismatches == ["birds at time code 5: 12 points instead of 9"]
    (tmp_path / "shot.scene.yaml").write_text(
        SCENE.replace("name: cord", "name: wire").replace("fps: 24", "fps: 25"), "utf-8"
    )
    done = animtool("diff", baked, bake(tmp_path, "two"))
    assert done.code == 1
    assert "1 prim is not in the second: cord" in done.stdout
    assert "1 prim is not in the first: wire" in done.stdout
    assert "24 time codes per second instead of 25" in done.stdout


def test_arrays_that_do_not_fit_are_refused(baked: Path) -> None:
    short = edited(baked, "short", ids=lambda ids: ids[:5])
    done = animtool("diff", baked, short)
    assert (done.code, "USD269" in done.stderr) == (3, True)
