"""What every command that writes keeps to: what exists, streams, reports, bytes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from pxr import Sdf
from support.cli import Done, animtool
from support.printed import make_project, shorten

WALK = "samples/walk/walk.bvh"
TARGETS = "samples/correctives/touch.targets.yaml"
ARM = "samples/correctives/arm.rig.yaml"
BIPED = "rigs/biped/biped.rig.yaml"
TEMPLATE = "rigs/biped/biped.markers.yaml"
CAMERAS = "samples/capture/stage.cameras.yaml"
CAPTURE = "samples/capture/take.npz"
SPEECH = "samples/face/speech.npz"
HEAD = "rigs/head/head.rig.yaml"
LANDMARKS = "samples/face/head.landmarks.yaml"
TEXT = {".usda": "#usda 1.0", ".bvh": "HIERARCHY", ".rig.yaml": "rig: animtool/1"}


@dataclass(frozen=True)
class Command:
    """What is run in a project.

    Attributes:
        report: What its report is called.
        words: With ``{out}`` for what it writes.
        suffix: Of that.
        stdout: Whether it may go there.
        quick: Whether it is run to its end here.
    """

    report: str
    words: str
    suffix: str = ".usda"
    stdout: bool = False
    quick: bool = True

    def run(self, output: Path | str, *flags: str, cwd: Path) -> Done:
        words = [word.format(out=output) for word in self.words.split()]
        return animtool(*words, *flags, cwd=cwd)


COMMANDS = {
    "bake": Command("bake", f"bake {WALK} -o {{out}}", stdout=True),
    "bake of a scene": Command(
        "bake", "bake samples/carry/carry.scene.yaml -o {out}", stdout=True
    ),
    "convert": Command("convert", f"convert {WALK} {{out}}", ".bvh"),
    "convert of a rig": Command("convert", f"convert {HEAD} {{out}}"),
    "ik": Command("ik", f"ik {ARM} -t {TARGETS} -o {{out}}", stdout=True),
    "retarget": Command(
        "retarget", f"retarget {WALK} --to {BIPED} -o {{out}}", stdout=True
    ),
    "loop": Command("loop", f"loop {WALK} -o {{out}}"),
    "mocap clean": Command("mocap clean", f"mocap clean {WALK} -o {{out}}", ".bvh"),
    "mocap triangulate": Command(
        "mocap triangulate",
        f"mocap triangulate {CAPTURE} --cameras {CAMERAS} -o {{out}}",
        ".c3d",
    ),
    "mocap solve": Command(
        "mocap solve",
        f"mocap solve {CAPTURE} --template {TEMPLATE} -o {{out}}",
        quick=False,
    ),
    "mocap face": Command(
        "mocap face",
        f"mocap face {SPEECH} --rig {HEAD} --landmarks {LANDMARKS} -o {{out}}",
        quick=False,
    ),
    "mocap fill": Command(
        "mocap fill", f"mocap fill {CAPTURE} -o {{out}}", ".c3d", quick=False
    ),
    "mocap label": Command(
        "mocap label",
        f"mocap label {CAPTURE} --static {CAPTURE} -o {{out}}",
        ".c3d",
        quick=False,
    ),
}
QUICK = [name for name, command in COMMANDS.items() if command.quick]
STREAMED = [name for name, command in COMMANDS.items() if command.stdout]


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the samples, on few frames; nothing is written there."""
    folder = tmp_path_factory.mktemp("project")
    make_project(folder)
    shorten(folder)
    return folder


@pytest.fixture
def there(tmp_path: Path) -> dict[str, Path]:
    """Return an output of somebody else's by the command that would write it."""
    found = {}
    for name, command in COMMANDS.items():
        found[name] = tmp_path / f"{name}{command.suffix}"
        found[name].write_text("mine")
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_what_exists_is_not_replaced_unasked(
    project: Path, there: dict[str, Path], name: str
) -> None:
    done = COMMANDS[name].run(there[name], cwd=project)
    assert done.code == 2
    assert "OUT001" in done.stderr
    assert "--overwrite" in done.stderr
    assert there[name].read_text() == "mine"


@pytest.mark.parametrize("name", COMMANDS)
def test_what_exists_may_be_skipped(
    project: Path, there: dict[str, Path], name: str
) -> None:
    flags = ("--skip-existing", "--format", "json")
    done = COMMANDS[name].run(there[name], *flags, cwd=project)
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert report[COMMANDS[name].report] == "animtool/1"
    assert report["skipped"] == str(there[name])
    assert sorted(report.values()) == sorted(["animtool/1", str(there[name])])
    assert there[name].read_text() == "mine"


@pytest.mark.parametrize("name", COMMANDS)
def test_what_exists_is_not_both_replaced_and_kept(
    project: Path, there: dict[str, Path], name: str
) -> None:
    flags = ("--skip-existing", "--overwrite")
    done = COMMANDS[name].run(there[name], *flags, cwd=project)
    assert done.code == 2
    assert there[name].read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_what_is_replaced_and_what_is_new_are_the_same_bytes(
    project: Path, there: dict[str, Path], name: str
) -> None:
    command = COMMANDS[name]
    again = there[name].with_name("again") / there[name].name
    again.parent.mkdir()
    flags = ("--format", "json")
    done = command.run(there[name], "--overwrite", *flags, cwd=project)
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert report[command.report] == "animtool/1"
    assert isinstance(report["notices"], list)
    # Under quiet and strict too: there is nothing to warn of, and nothing is said.
    other = command.run(again, "--quiet", "--strict", cwd=project)
    assert (other.code, other.stdout, other.stderr) == (0, "", "")
    assert there[name].read_bytes() == again.read_bytes() != b"mine"
    if command.suffix in TEXT:
        assert there[name].read_text().startswith(TEXT[command.suffix])


@pytest.mark.parametrize("name", STREAMED)
def test_a_layer_goes_to_stdout_alone(project: Path, name: str) -> None:
    before = sorted(project.rglob("*"))
    done = COMMANDS[name].run("-", cwd=project)
    assert done.code == 0, done.stderr
    assert done.stdout.startswith("#usda 1.0")
    assert Sdf.Layer.CreateAnonymous(".usda").ImportFromString(done.stdout)
    refused = COMMANDS[name].run("-", "--format", "json", cwd=project)
    assert (refused.code, refused.stdout) == (2, "")
    assert sorted(project.rglob("*")) == before
