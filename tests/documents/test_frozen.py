"""A file of every version of every format, which is read for ever."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool.batch.file import load_batch
from animtool.batch.spec import Limits
from animtool.capture.cameras.file import load_cameras
from animtool.capture.face.file import face_model, load_landmarks
from animtool.capture.templates import TemplateMarker, load_template
from animtool.clip.file import load_clip, open_clip
from animtool.core.shot import FrameRange, Shot
from animtool.documents.migrate import plan_migration
from animtool.documents.versions import MIGRATION_STEPS, newest_version_of
from animtool.ik.file import load_targets
from animtool.retarget import TwistFraction
from animtool.retarget.file import load_map, resolve_map
from animtool.rig.file import load_rig
from animtool.rig.remap import ShapeLink, link_shapes, load_remap
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.file.read import load_scene
from animtool.scene.file.tracks import TrackNames
from animtool.scene.solves.ik import rest_take

FROZEN = Path(__file__).parent / "frozen"


@pytest.mark.parametrize("kind", sorted(MIGRATION_STEPS))
def test_there_is_a_file_of_every_version(kind: str) -> None:
    first = min(MIGRATION_STEPS[kind], default=newest_version_of(MIGRATION_STEPS[kind]))
    for version in range(first, newest_version_of(MIGRATION_STEPS[kind]) + 1):
        plan = plan_migration(FROZEN / f"{kind}-{version}.{kind}.yaml")
        assert (plan.kind, plan.version) == (kind, version)


@pytest.mark.slow
def test_batch_1(tmp_path: Path) -> None:
    folder = tmp_path / "frozen"
    shutil.copytree(FROZEN, folder)
    spec = load_batch(folder / "batch-1.batch.yaml")
    assert (spec.name, spec.jobs, spec.limits) == ("batch-1", 1, Limits(600, 8 * 10**9))
    options = spec.options
    assert (options.fps, options.start, options.form) == (30, 1001, "split")
    assert (options.reduce, options.reduce_at) == (0.001, (("elbow_l", 0.0001),))
    done = animtool("batch", folder / "batch-1.batch.yaml", "--executor", "serial",
                    "--exclude", folder / "none")  # fmt: skip
    assert done.code == 2, "serial keeps no limits"
    done = animtool("batch", folder / "batch-1.batch.yaml")
    assert done.code == 0, done.stderr
    assert (folder / "out/sh010/clip-1.anim.usdc").is_file()


def test_rig_1() -> None:
    rig = load_rig(FROZEN / "rig-1.rig.yaml")
    assert (rig.name, rig.meters_per_unit, str(rig.up)) == ("frozen", 0.01, "Z")
    assert set(rig.names) == {
        *("hips", "chest", "piston"),
        *("arm_l", "elbow_l", "wrist_l", "arm_r", "elbow_r", "wrist_r"),
    }
    assert set(rig.bind) == {"arm_l", "arm_r"}
    assert [len(part) for part in (rig.meshes, rig.shapes, rig.controls)] == [1, 3, 2]
    assert [len(part) for part in (rig.chains, rig.attach, rig.colliders)] == [1, 1, 1]


def test_clip_1() -> None:
    file = open_clip(FROZEN / "clip-1.clip.yaml")
    assert file.rig_path == (FROZEN / "rig-1.rig.yaml").resolve()
    clip = load_clip(file, load_rig(file.rig_path))
    assert [len(c.times) for c in clip.channels] == [2, 2, 5, 2, 3, 2, 1, 1, 1]
    assert (clip.first, float(clip.last)) == (-1, 12.5)


def test_cameras_1() -> None:
    found = load_cameras(FROZEN / "cameras-1.cameras.yaml")
    assert (found.names, str(found.up)) == (("front", "side"), "Z")
    front, side = found.cameras
    assert (front.focal, front.centre) == ((1334.5, 1333.25), (949.5, 539.25))
    assert (front.size, front.skew, side.size) == ((1920, 1080), 0.5, None)
    assert front.distortion == (-0.073, 0.006, 0.001, -0.002, 0.0003, 0.01, 0.02, 0.03)
    assert side.distortion == (-0.1, 0.01, 0, 0, 0, 0, 0, 0)
    assert front.rotation.tolist() == [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    assert front.translation.tolist() == [0, 0.9, 4]
    turned = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    np.testing.assert_allclose(side.rotation, turned, atol=1e-15)


def test_map_1() -> None:
    names = ["Hips", "Spine", "Spine1", "LeftArm", "HeadTop_End"]
    source = Rig("take", tuple(Joint(name, -1) for name in names))
    names = ["hips", "spine_1", "spine_2", "spine_3", "arm_l", "twist_l", "ik_hand_l"]
    target = Rig("rig", tuple(Joint(name, -1) for name in names))
    found = resolve_map(load_map(FROZEN / "map-1.map.yaml"), source, target)
    entries = [(each.source, each.target, each.role) for each in found.entries]
    assert entries == [
        ((0,), (0,), ""),
        ((1, 2), (1, 2, 3), "spine"),
        ((3,), (4,), "upper_arm_l"),
    ]
    assert found.twists == (TwistFraction(5, 4, 0.25),)
    assert found.ignored_joints == ({4}, {6})
    assert not found.is_exclusive


def test_markers_1() -> None:
    template = load_template(FROZEN / "markers-1.markers.yaml")
    assert template.rig == (FROZEN / "rig-1.rig.yaml").resolve()
    assert template.markers == (
        TemplateMarker("CHES", "chest", (0, 0.05, 0.1), 1, False, ("STRN", "Sternum")),
        TemplateMarker("LELB", "elbow_l", (0, 0.03, 0), 0.5, True),
        TemplateMarker("HIPS", "hips"),
    )
    joints = template.joints(load_rig(template.rig)).tolist()
    names = load_rig(template.rig).names
    assert [names[j] for j in joints] == ["chest", "elbow_l", "hips"]


def test_landmarks_1() -> None:
    file = load_landmarks(FROZEN / "landmarks-1.landmarks.yaml")
    assert file.rig == (FROZEN / "rig-1.rig.yaml").resolve()
    model = face_model(file, load_rig(file.rig))
    assert model.names == ("tip", "side", "middle")
    assert model.neutral.shape == (3, 3)


def test_remap_1() -> None:
    found = load_remap(FROZEN / "remap-1.remap.yaml")
    links = link_shapes(["Smile_L", "Jaw", "x"], ["jawOpen", "mouthSmileLeft"], found)
    assert links.links == (
        ShapeLink(0, 1),
        ShapeLink(1, 0, 0.8, -0.1, 0.0, 1.0),
    )
    assert links.unlinked == ("x",)


def test_scene_1(tmp_path: Path) -> None:
    folder = tmp_path / "frozen"
    shutil.copytree(FROZEN, folder)
    # What a scene reads must be there.
    for name in ("walk.bvh", "hero.usda"):
        (folder / name).touch()
    scene = load_scene(folder / "scene-1.scene.yaml")
    assert scene.sources[0].path.name == "clip-1.clip.yaml"
    assert [entry.pass_.name for entry in scene.passes] == ["trim", "loop"]
    layer = load_scene(folder / "scene-1-bvh.scene.yaml")
    assert (layer.sources[0].options.prim_path, layer.bake.form) == ("/hero", "layer")
    done = animtool("bake", folder / "scene-1.scene.yaml")
    assert done.code == 0, done.stderr
    assert (folder / "scene-1.usda").is_file()


def test_scene_1_of_a_shot(tmp_path: Path) -> None:
    folder = tmp_path / "frozen"
    shutil.copytree(FROZEN, folder)
    scene = load_scene(folder / "scene-1-shot.scene.yaml", {"shot": "sh020"})
    assert scene.variables == {"shot", "out", "handles"}
    assert [source.timecode for source in scene.sources] == [
        "01:00:00:00",
        "01:00:00:02.5",
    ]
    assert scene.sources[1].tracks == TrackNames(("wrist_*",), ("jaw",), ("grin",))
    assert (scene.bake.frame_range, scene.bake.shot) == (
        FrameRange(1003, 1010),
        Shot(1005, 1008, 2, 2),
    )
    assert len(scene.bake.samples) == 3
    assert [output.path and output.path.name for output in scene.outputs] == [
        "sh020_shot.usda",
        "sh020_shot.clip.yaml",
        "${out}.bvh",
    ]
    done = animtool("bake", folder / "scene-1-shot.scene.yaml")
    assert done.code == 0, done.stderr
    for name in ("frozen_shot.usda", "frozen_shot.clip.yaml", "${out}.bvh"):
        assert (folder / name).is_file()


def test_scene_1_with_props_props(tmp_path: Path) -> None:
    folder = tmp_path / "frozen"
    shutil.copytree(FROZEN, folder)
    scene = load_scene(folder / "scene-1-beside.scene.yaml")
    prop, still = scene.props
    assert (prop.prim, prop.path, prop.frame) == ("/World/prop", "Props/prop", 2)
    assert (prop.is_retimed, still.is_retimed) == (True, False)
    assert still.attributes == ("visibility",)
    assert (prop.reference, still.reference) == (prop.file, None)
    assert [output.bake.take for output in scene.outputs] == [None, "slow"]
    done = animtool("bake", folder / "scene-1-beside.scene.yaml")
    assert done.code == 0, done.stderr
    for name in ("beside.usda", "moves.usda"):
        assert "Props" in (folder / name).read_text("utf-8")


def test_targets_1() -> None:
    rig = load_rig(FROZEN / "rig-1.rig.yaml")
    tracks = load_targets(FROZEN / "targets-1.targets.yaml", rig)
    assert (tracks.clock.start, tracks.clock.count) == (1, 24)
    assert [track.goal.joint for track in tracks.goals] == [
        "wrist_l",
        "wrist_r",
        "hips",
    ]
    assert [track.goal.weights for track in tracks.goals] == [
        (1, 1, 0, 1),
        (1, 1, 1, 0),
        (1, 1, 0, 0),
    ]
    assert [track.goal.priority for track in tracks.goals] == [0, 1, 0]
    assert [track.goal.stretch for track in tracks.goals] == [0.1, 0.2, 0.0]
    assert [track.goal.soft for track in tracks.goals] == [0.0, 0.05, 0.0]
    assert tracks.goals[1].spans == ((3, 6), (12, 20))
    targets = tracks.sample(rig, tracks.clock, rest_take(rig, tracks.clock).world())
    found = np.asarray(targets.positions)[:, 2]
    # Frame 23 at 24000/1001, on a stage of 24 time codes a second.
    np.testing.assert_allclose(found[-2], [0.23 * 1.001, 0.05, 0.9])
