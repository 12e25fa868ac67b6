from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from preview.pages import ReadPage
from support.bvh import random_rows, small_bvh
from support.cli import animtool
from support.skinned_rig import write_pair

from animtool import read_bvh
from animtool.core.errors import AnimtoolError
from animtool.core.shot import FrameList, FrameRange
from animtool.core.units import UpAxis
from animtool.motion.reorient import reorient
from animtool.preview.build import make_page, write_page
from animtool.preview.open_file import rest_take
from animtool.preview.options import PreviewOptions
from animtool.preview.show import show
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import SourceOptions, open_source

PLAIN = PreviewOptions(findings=False)


def page_of(*files: Path, options: PreviewOptions = PLAIN) -> ReadPage:
    return ReadPage(make_page(files, options).html())


@pytest.mark.parametrize("up", [None, UpAxis.Z])
def test_a_page_holds_the_take_within_the_error_that_it_states(
    walk: Path, up: UpAxis | None
) -> None:
    source = SourceOptions(up=up)
    page = page_of(walk, options=PreviewOptions(source=source, findings=False))
    take = reorient(read_bvh(walk, up=up), UpAxis.Y).collect()
    t, r = page.locals()
    errors = page.manifest["errors"]
    places = forward_kinematics(
        take.rig, t, r / np.linalg.norm(r, axis=-1, keepdims=True)
    )
    apart = np.linalg.norm(places.positions - take.world().positions, axis=-1)
    assert 0 < apart.max() * 1000 <= errors["position_mm"] < 0.2
    assert 0 < errors["rotation_deg"] < 0.01
    assert page.manifest["time"] == {
        "first": 1,
        "step": 1,
        "count": len(take),
        "rate": [30, 1],
        "label": "30 fps",
    }


@pytest.mark.slow
def test_one_motion_makes_equal_pages_whatever_its_format(
    walk: Path, root: Path, tmp_path: Path
) -> None:
    clip = root / "samples/stride/stride.clip.yaml"
    for source in (walk, clip):
        baked = tmp_path / f"{source.stem}.usdc"
        bake(source, baked)
        one, other = (
            ReadPage(make_page([path], PLAIN).html()) for path in (source, baked)
        )
        for mine, theirs in zip(one.locals(), other.locals(), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        ours, others = (page.manifest["takes"][0] for page in (one, other))
        for key in ("moving", "contacts", "span", "offset"):
            assert ours[key] == others[key]
        for key in ("names", "parents"):
            assert ours["skeleton"][key] == others["skeleton"][key]
        assert one.manifest["time"] == other.manifest["time"]
        assert len(one.manifest["meshes"]) == len(other.manifest["meshes"])
        if source == walk:
            assert one.blocks == other.blocks
            named = {"title", "source"}
            for key in one.manifest.keys() - named:
                assert one.manifest[key] == other.manifest[key]
    keyed = tmp_path / "walk.clip.yaml"
    assert animtool("convert", walk, keyed).code == 0
    rig = read_bvh(walk).rig
    one, other = (
        forward_kinematics(
            rig, t, r / np.linalg.norm(r, axis=-1, keepdims=True)
        ).positions
        for t, r in (page_of(path).locals() for path in (walk, keyed))
    )
    assert np.linalg.norm(one - other, axis=-1).max() < 1e-3


@pytest.mark.slow
def test_the_same_files_make_the_same_bytes_and_no_path_is_in_them(
    tmp_path: Path, root: Path
) -> None:
    scene = root / "samples/rope/lantern.scene.yaml"
    for name in "ab":
        write_page([scene], tmp_path / f"{name}.html")
    text = (tmp_path / "a.html").read_bytes()
    assert text == (tmp_path / "b.html").read_bytes()
    for place in (str(root), str(tmp_path), "/tmp", str(Path.home())):
        assert place.encode() not in text
    assert b"http://" not in text.replace(b"http://www.w3.org/", b"")
    assert b"https://" not in text


HOSTILE = [
    "</script><script>alert(1)</script>",
    "\"'`${x}\\",
    "\u202egnp.exe",
    "\U0001f9be\u2028\u2029",
    "&lt;b&gt; {{blocks}}",
    "n" * 10_000,
]


def test_hostile_names_stay_names(tmp_path: Path) -> None:
    joints = tuple(Joint(name, -1) for name in HOSTILE)
    page = ReadPage(show(rest_take(Rig(HOSTILE[0], joints)).collect()).page.html())
    assert page.manifest["takes"][0]["skeleton"]["names"] == HOSTILE
    assert page.manifest["title"] == HOSTILE[0]
    folder = tmp_path / "<img src=x onerror=alert(1)>{{title}}"
    folder.mkdir()
    named = folder / "a'\"&<b>{{manifest}}.bvh"
    named.write_text(small_bvh(random_rows(2)))
    other = page_of(named)
    assert other.manifest["source"]["files"] == [named.name]
    for one in (page, other):
        assert one.text.count("<script") == one.text.count("</script>")
        assert one.text.count('id="manifest"') == 1
        assert "alert(1)</" not in one.text
        assert "<img" not in one.text
        assert "<b>" not in one.text
    scripts = [
        one.text.count("<script") - one.text.count('class="block"')
        for one in (page, other)
    ]
    assert scripts[0] == scripts[1]


@pytest.mark.slow
def test_a_thousand_curves_share_a_stream(tmp_path: Path) -> None:
    count = 1000
    controls = "\n".join(f"- {{name: c{i}, range: [0, 1]}}" for i in range(count))
    joints = "joints:\n- {name: a, type: free}\n"
    text = f"rig: animtool/1\nname: many\n{joints}controls:\n{controls}\n"
    (tmp_path / "many.rig.yaml").write_text(text, "utf-8")
    keys = "keys: [{t: 1, v: 0}, {t: 3, v: 1}]"
    channels = "\n".join(
        f"- {{target: control/c{i}, interp: linear, {keys}}}" for i in range(count)
    )
    head = "clip: animtool/1\nrig: many.rig.yaml\nfps: 24\nrange: [1, 3]\nchannels:\n"
    (tmp_path / "many.clip.yaml").write_text(head + channels + "\n", "utf-8")
    page = page_of(tmp_path / "many.clip.yaml")
    channels_of = page.manifest["channels"]
    assert len(channels_of) == count
    assert len({channel["values"] for channel in channels_of}) == 1
    values = page.values(channels_of[0]["values"])
    assert values.shape == (3, count)
    np.testing.assert_allclose(values[:, 999], [0, 0.5, 1], atol=1e-6)
    assert channels_of[999]["keys"] == [[1.0, 0.0], [3.0, 1.0]]
    assert len(page.text) < 200_000


def test_one_frame_and_no_joints(tmp_path: Path) -> None:
    still = tmp_path / "still.bvh"
    still.write_text(small_bvh(random_rows(1)))
    page = page_of(still)
    assert page.manifest["time"]["count"] == 1
    assert page.manifest["takes"][0]["moving"] == {"t": [], "r": [], "s": []}
    nobody = rest_take(Rig("nobody", ())).collect()
    made = ReadPage(show(nobody).page.html())
    assert made.manifest["takes"][0]["skeleton"]["names"] == []
    assert made.manifest["time"]["count"] == 1


def test_a_stage_that_shows_nothing_makes_a_page(tmp_path: Path) -> None:
    stage = tmp_path / "empty.usda"
    stage.write_text('#usda 1.0\ndef Xform "World" {}\n')
    page = page_of(stage)
    assert page.manifest["time"]["count"] == 1
    assert not page.manifest["takes"]
    assert not page.manifest["meshes"]


def test_frames_are_those_of_the_shot(walk: Path, tmp_path: Path) -> None:
    bake(walk, tmp_path / "shot.usdc", BakeOptions(start=Fraction(1001)))
    options = PreviewOptions(frame_range=FrameRange(1003, 1009, 2), findings=False)
    page = page_of(tmp_path / "shot.usdc", options=options)
    time = page.manifest["time"]
    assert (time["first"], time["step"], time["count"]) == (1003, 2, 4)
    whole = page_of(tmp_path / "shot.usdc")
    np.testing.assert_allclose(page.locals()[1], whole.locals()[1][2:9:2], atol=1e-9)
    with pytest.raises(AnimtoolError) as caught:
        page_of(
            tmp_path / "shot.usdc",
            options=PreviewOptions(frame_range=FrameRange(1, 9)),
        )
    assert caught.value.code == "CLI005"


def test_takes_are_compared_on_one_timeline(walk: Path, tmp_path: Path) -> None:
    bake(walk, tmp_path / "late.usdc", BakeOptions(start=Fraction(1001)))
    bake(walk, tmp_path / "fast.usdc", BakeOptions(fps=Fraction(60)))
    made = make_page([walk, tmp_path / "late.usdc", tmp_path / "fast.usdc"], PLAIN)
    page = ReadPage(made.html())
    spans = [take["span"] for take in page.manifest["takes"]]
    assert spans == [[0, 63]] * 3
    assert {n.code for n in made.notices} >= {"PRV103", "PRV104"}
    first = page.locals(0)[1]
    for other in (1, 2):
        assert np.abs(page.locals(other)[1] - first).max() < 1e-3


def test_skins_and_shapes_give_the_points_of_the_mesh(tmp_path: Path) -> None:
    clip = write_pair(tmp_path)
    page = page_of(clip)
    mesh = next(m for m in page.manifest["meshes"] if m["skin"])
    skin = mesh["skin"]
    weights = page.values(skin["weights"]).reshape(-1, 4)
    joints = page.values(skin["joints"]).astype(int).reshape(-1, 4)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)
    bind = page.values(skin["bind"]).reshape(-1, 4, 4).swapaxes(1, 2)
    points = page.values(mesh["points"]).reshape(-1, 3)
    entry = page.manifest["takes"][0]
    shapes = page.values(entry["shapes"]["weights"]) if entry["shapes"] else None
    baked = tmp_path / "deformed.usda"
    bake(clip, baked, BakeOptions(deform=True))
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(baked))
    prim = next(
        p
        for p in stage.Traverse()
        if p.GetName() == mesh["name"] and p.IsA(UsdGeom.Mesh)
    )
    t, r = page.locals()
    rig = open_source(clip).rig
    world = forward_kinematics(rig, t, r / np.linalg.norm(r, axis=-1, keepdims=True))
    for frame in (0, len(t) - 1):
        shaped = points.copy()
        for shape in mesh["shapes"]:
            assert shapes is not None
            at = page.values(shape["vertices"]).astype(int)[0]
            offsets = page.values(shape["offsets"]).reshape(-1, 3)
            shaped[at] += shapes[frame, shape["column"]] * offsets
        matrices = np.tile(np.eye(4), (len(skin["palette"]), 1, 1))
        matrices[:, :3, :3] = world.linear[frame, skin["palette"]]
        matrices[:, :3, 3] = world.positions[frame, skin["palette"]]
        moved = np.einsum(
            "jab,vb->vja", matrices @ bind, np.c_[shaped, np.ones(len(points))]
        )
        rows = np.arange(len(points))[:, None]
        found = (moved[rows, joints, :3] * weights[..., None]).sum(axis=1)
        code = page.manifest["time"]["first"] + frame
        expected = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(code))
        unit = UsdGeom.GetStageMetersPerUnit(stage)
        assert np.abs(found - expected * unit).max() < 3e-4


@pytest.mark.parametrize("scene", ["rope/rope", "shot/shot"])
def test_scenes_are_shown_as_their_bake_has_them(root: Path, scene: str) -> None:
    page = page_of(root / f"samples/{scene}.scene.yaml")
    manifest = page.manifest
    if scene == "rope/rope":
        points = page.values(manifest["curves3d"][0]["points"])
        assert points.shape[0] == manifest["time"]["count"]
        return
    assert manifest["time"]["first"] == 1001
    camera = manifest["cameras"][0]
    assert camera["focal_mm"] == pytest.approx(35.0, abs=1e-4)
    focal = page.values(camera["focal"])[:, 0]
    assert focal[-1] == pytest.approx(50.0, abs=1e-3)
    assert {one["name"].split("/")[0] for one in manifest["instances"]} == {"Props"}


@pytest.mark.slow(1)
def test_copies_are_where_their_stage_has_them(root: Path, tmp_path: Path) -> None:
    baked = tmp_path / "dominoes.usdc"
    bake(root / "samples/dominoes/dominoes.scene.yaml", baked)
    page = page_of(baked)
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(baked))
    prim = UsdGeom.PointInstancer(stage.GetPrimAtPath("/dominoes/row"))
    entry = page.manifest["instances"][0]
    places = page.values(entry["t"])
    code = page.manifest["time"]["first"] + len(places) - 1
    expected = np.array(prim.GetPositionsAttr().Get(code))
    kinds = np.array(prim.GetProtoIndicesAttr().Get(code))
    found = places[-1].reshape(-1, 3)
    assert len(found) == (kinds == 0).sum()
    limit = page.manifest["errors"]["position_mm"] / 1000 + 1e-6
    assert np.abs(found - expected[kinds == 0]).max() <= limit


@pytest.mark.slow(1)
def test_points_that_come_and_go_are_gaps(root: Path, tmp_path: Path) -> None:
    baked = tmp_path / "embers.usdc"
    bake(root / "samples/embers/embers.scene.yaml", baked)
    page = page_of(baked)
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(baked))
    prim = UsdGeom.Points(stage.GetPrimAtPath("/embers/embers"))
    values = page.values(page.manifest["points"][0]["positions"])
    for frame in (0, 40, 95):
        expected = np.array(prim.GetPointsAttr().Get(1 + frame))
        rows = values[frame].reshape(-1, 3)
        found = rows[np.isfinite(rows[:, 0])]
        assert len(found) == len(expected)
        order = np.lexsort(found.round(3).T), np.lexsort(expected.round(3).T)
        assert np.abs(found.sum(axis=0) - expected.sum(axis=0)).max() < 0.05
        assert len(order[0]) == len(order[1])


def test_findings_have_their_frame_and_joint(tmp_path: Path) -> None:
    rows = np.zeros((24, 9))
    rows[:, 6] = np.linspace(0, 4, 24)
    rows[12:, 6] += 120
    path = tmp_path / "pop.bvh"
    path.write_text(small_bvh(rows))
    found = page_of(path, options=PreviewOptions()).manifest["findings"]
    pop = [one for one in found if one["code"].startswith("MOT2") and one["joint"]]
    assert pop
    assert pop[0]["joint"] == "Spine"
    assert pop[0]["frame"] in {12.0, 13.0}
    assert pop[0]["take"] == 0
    assert all(str(tmp_path) not in one["message"] for one in found)


@pytest.mark.parametrize(
    ("name", "text", "code"),
    [
        ("a.batch.yaml", "batch: animtool/1\n", "PRV001"),
        ("a.cameras.yaml", "cameras: animtool/1\n", "PRV001"),
        ("a.fbm", "", "IO002"),
    ],
)
def test_what_shows_nothing_is_refused(
    tmp_path: Path, name: str, text: str, code: str
) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(AnimtoolError) as caught:
        make_page([path])
    assert caught.value.code == code


def test_curves_of_a_clip_go_with_its_frames(tmp_path: Path, walk: Path) -> None:
    (tmp_path / "r.rig.yaml").write_text(
        "rig: animtool/1\nname: r\njoints:\n- {name: a, type: free}\n"
    )
    clip = tmp_path / "c.clip.yaml"
    clip.write_text(
        "clip: animtool/1\nrig: r.rig.yaml\nfps: 15\nrange: [1001, 1011]\nchannels:\n"
        "- {target: joint/a.translation, interp: linear,\n"
        "   keys: [{t: 1001, v: [0, 0, 0]}, {t: 1011, v: [1, 0, 0]}]}\n"
    )
    for page, step in ((page_of(clip), 10), (page_of(walk, clip), 20)):
        channel = page.manifest["channels"][0]
        take = channel["take"]
        values = page.values(channel["values"])[:, channel["column"]]
        moved = page.locals(take)[0][:, 0, 0]
        np.testing.assert_allclose(values, moved, atol=1e-4)
        time = page.manifest["time"]
        begin = time["first"] + page.manifest["takes"][take]["span"][0]
        assert channel["keys"] == [[begin, 0.0], [begin + step, 1.0]]
        assert channel["unit"] == "m"


def test_channels_say_how_far_they_move(tmp_path: Path) -> None:
    """In radians, in sizes of the rig, or of 1."""
    (tmp_path / "a.rig.yaml").write_text(
        "rig: animtool/1\nname: a\njoints:\n"
        "- {name: root, type: free}\n"
        "- {name: a, type: pin, axis: [0, 0, 1], parent: root, translate: [0, 2, 0]}\n",
        "utf-8",
    )
    (tmp_path / "a.clip.yaml").write_text(
        "clip: animtool/1\nrig: a.rig.yaml\nfps: 24\nchannels:\n"
        "- {target: joint/root.translation, keys: [{t: 1, v: [0, 0, 0]}, "
        "{t: 9, v: [0, 1, 0]}]}\n"
        "- {target: joint/a.angle, keys: [{t: 1, v: 0}, {t: 9, v: 90}]}\n",
        "utf-8",
    )
    page = make_page([tmp_path / "a.clip.yaml"])
    moves = {each["name"]: each["moves"] for each in page.manifest["channels"]}
    assert moves["joint/root.translation.x"] == 0
    assert moves["joint/root.translation.y"] == pytest.approx(0.5, abs=1e-3)
    assert moves["joint/a.angle"] == pytest.approx(np.pi / 2, abs=1e-3)


@pytest.mark.parametrize(
    ("frames", "missing", "said"),
    [
        ([1, 5, 400], "frame 400 is", "1-64"),
        ([6, 7, 400, 500], "frames 400, 500 are", "1-64"),
        ([0, 5], "frame 0 is", "first frame is 1"),
    ],
)
def test_listed_frames_that_the_file_lacks(
    walk: Path, frames: list[int], missing: str, said: str
) -> None:
    options = PreviewOptions(frame_range=FrameList.of_frames(frames), findings=False)
    with pytest.raises(AnimtoolError) as caught:
        make_page([walk], options)
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("CLI005", str(walk))
    assert fault.message.startswith(f"frame_range: {missing} not in the file")
    assert said in fault.message


@pytest.mark.parametrize(
    ("frame_range", "codes"),
    [
        (FrameRange(1, 64), []),
        (FrameRange(2, 9), []),
        (FrameRange(2, 65, 2), []),
        (FrameRange(1, 65), ["SCN202"]),
        (FrameRange(0, 9), ["SCN202"]),
        (FrameList.of_frames([9, 2]), []),
    ],
)
def test_a_range_beyond_all_files_is_warned_of(
    walk: Path, frame_range: FrameRange, codes: list[str]
) -> None:
    page = make_page([walk], PreviewOptions(frame_range=frame_range, findings=False))
    assert [n.code for n in page.notices if n.code == "SCN202"] == codes


def test_a_page_refuses_a_list_by_its_option(walk: Path, tmp_path: Path) -> None:
    done = animtool("preview", walk, "-o", tmp_path / "a.html", "--range", "1,2")
    assert "PRV006 --range: " in done.stderr
