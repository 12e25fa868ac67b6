"""Every fault that a written file may have, planted in a clip and in a scene."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.cli import animtool
from support.clips import write_rig
from support.faults import document_faults

from animtool.core.files.reading import MAX_TEXT_BYTES
from animtool.core.rules import builtin_rules
from animtool.documents.document import MAX_FAULTS

CLIP = """\
clip: animtool/1
rig: hero.rig.yaml
fps: 24
range: [0, 8]
channels:
- target: joint/elbow_l.angle
  interp: bezier
  keys:
  - {t: 0, v: 0, out: [1, 0]}
  - {t: 8, v: 90}
- {target: control/grin, keys: [{t: 0, v: 0}]}
- {target: joint/hips.rotation, keys: [{t: 0, v: [1, 0, 0, 0]}]}
"""
SCENE = """\
scene: animtool/1
fps: 24
range: [1001, 1007]
source: {file: good.clip.yaml}
passes:
- trim: {first: 1, last: 8}
- loop: {}
output: {file: shot.usda, start: 1001}
"""

# Text to find, text to put there, code, line; of clips, then of scenes.
CLIPS = [
    *document_faults("clip", "range: [0, 8]", 4),
    ("range: [0, 8]", "range: [0, " + "8" * 500 + "]", "DOC001", 4),
    ("clip: animtool/1", "rig: animtool/1\nn: 1", "DOC004", 3),
    ("fps: 24\n", "", "DOC021", 1),
    ("range: [0, 8]", "range: [0, x]", "DOC022", 4),
    ("joint/elbow_l.angle", "elbow_l.angle", "CLIP001", 6),
    ("control/grin", "control/grim", "CLIP002", 11),
    ("elbow_l.angle", "elbow_l.slide", "CLIP003", 6),
    ("t: 8", "t: 0", "CLIP004", 10),
    ("out: [1, 0]", "out: [-1, 0]", "CLIP005", 9),
    ("range: [0, 8]", "range: [8, 0]", "CLIP006", 4),
    ("v: 90", "v: [90, 1]", "CLIP007", 10),
    ("fps: 24", "fps: fast", "SCN022", 3),
    ("interp: bezier", "interp: slerp", "CLIP009", 7),
    ("control/grin", "joint/elbow_l.angle", "CLIP010", 11),
    ("rig: hero.rig.yaml", "rig: ../hero.rig.yaml", "DOC014", 2),
    (CLIP[CLIP.index("range") :], "channels: []\n", "CLIP013", 4),
    ("[1, 0, 0, 0]", "[0, 0, 0, 0]", "RIG006", 12),
]
SCENES = [
    *document_faults("scene", "range: [1001, 1007]", 3),
    ("source: {file: good.clip.yaml}", "", "DOC021", 1),
    ("range: [1001, 1007]", "range: [1, 9, 2]", "DOC022", 3),
    ("range: [1001, 1007]", "range: [1.5, 9]", "DOC022", 3),
    ("- loop: {}", "- loop: {}\n  trim: {}", "DOC022", 8),
    ("last: 8", "lats: 8", "SCN001", 6),
    ("last: 8", "last: soon", "SCN002", 6),
    ("range: [1001, 1007]", "range: [9, 1]", "SCN003", 3),
    ("fps: 24", "fps: 0", "SCN022", 2),
    ("file: good.clip.yaml", "file: /good.clip.yaml", "DOC014", 4),
    ("file: shot.usda", "file: ../shot.usda", "DOC014", 8),
    ("loop: {}", "layer: {take: no.bvh}", "DOC015", 7),
    ("loop:", "lop:", "SCN010", 7),
]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Return a folder with a rig and a sound clip and scene."""
    write_rig(tmp_path)
    (tmp_path / "animtool.toml").touch()
    (tmp_path / "good.clip.yaml").write_text(CLIP)
    (tmp_path / "good.scene.yaml").write_text(SCENE)
    return tmp_path


def said(project: Path, name: str, data: bytes) -> list[tuple[str, int]]:
    """Return code and line of what is said of a file that cannot be baked."""
    (project / name).write_bytes(data)
    before = sorted(project.iterdir())
    done = animtool("bake", name, "-o", "out.usda", cwd=project)
    assert done.code == 3, done.stderr
    assert sorted(project.iterdir()) == before
    lines = done.fault_lines
    assert all(line.startswith(f"{name}:") for line in lines)
    found = [re.match(rf"{name}:(\d+)?.*?\b([A-Z]+\d+)\b", line) for line in lines]
    return [(match[2], int(match[1] or 0)) for match in found if match]


@pytest.mark.parametrize(("old", "new", "code", "line"), CLIPS)
def test_a_fault_of_a_clip(
    project: Path, old: str, new: str, code: str, line: int
) -> None:
    assert old in CLIP
    data = CLIP.replace(old, new, 1).encode("utf-8", "surrogateescape")
    assert said(project, "bad.clip.yaml", data) == [(code, line)]


@pytest.mark.parametrize(("old", "new", "code", "line"), SCENES)
def test_a_fault_of_a_scene(
    project: Path, old: str, new: str, code: str, line: int
) -> None:
    assert old in SCENE
    data = SCENE.replace(old, new, 1).encode("utf-8", "surrogateescape")
    assert said(project, "bad.scene.yaml", data) == [(code, line)]


@pytest.mark.parametrize("kind", ["clip", "scene"])
def test_files_that_are_none(project: Path, kind: str) -> None:
    name = f"bad.{kind}.yaml"
    assert said(project, name, b"") == [("DOC007", 1)]
    assert said(project, name, b" " * (MAX_TEXT_BYTES + 1)) == [("DOC006", 0)]
    many = f"{kind}: animtool/1\n" + "".join(
        f"key_{i}: 1\n" for i in range(MAX_FAULTS + 9)
    )
    found = said(project, name, many.encode())
    assert len(found) == MAX_FAULTS + 1
    assert found[-1] == ("DOC011", 0)


def test_sound_files_bake(project: Path) -> None:
    for name in ("good.clip.yaml", "good.scene.yaml"):
        done = animtool("bake", name, "-o", "out.usda", "--overwrite", cwd=project)
        assert done.code == 0, done.stderr


def test_no_code_of_reading_is_left_out() -> None:
    planted = {code for _, _, code, _ in [*CLIPS, *SCENES]}
    planted |= {"DOC006", "DOC011"}
    # Said of options, of arrays, of expressions while they are sampled, and of
    # plug-ins and versions that do not exist yet.
    elsewhere = {"CLIP011", "CLIP015", "CLIP016", "CLIP020", "CLIP021"}
    elsewhere |= {"IO003", "DOC013", "DOC101"}
    # Those of tests/documents.
    elsewhere |= {"DOC023", "DOC024", "DOC025", "DOC026", "DOC102", "DOC103"}
    of_reading = re.compile(r"DOC\d{3}|RIG006|CLIP0\d{2}|SCN0(?:0\d|1[01]|22)")
    codes = {code for code in builtin_rules() if of_reading.fullmatch(code)}
    assert codes - elsewhere == planted
