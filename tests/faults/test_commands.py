"""Commands that write several files: one that cannot get its name undoes the others."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from support.cli import animtool
from support.page_stage import make_stage
from support.skinned_rig import write_pair

from animtool.core.files.commit import WrittenFile, output_error
from faults.calls import Files, files_in

FAULTS = "fault | what happened | what was lost"
BAD = 'rig: animtool/1\nname: page\njoints: [{name: "a.l", type: free}]\n'
STATES = """scene: animtool/1
source: {file: wave.clip.yaml}
output:
- {file: o.usdc}
- {file: o.clip.yaml}
"""
COMMANDS = {
    "bake --split": "bake walk.bvh -o o.usda --split --overwrite",
    "bake --deform --chunk": "bake pair.clip.yaml -o o.usdc --deform --chunk 4 "
    "--overwrite",
    "bake --deform, fewer chunks": "bake pair.clip.yaml -o cache.usdc --deform "
    "--chunk 4 --overwrite",
    "bake a scene of two outputs": "bake o.scene.yaml --overwrite",
    "convert to a clip": "convert walk.bvh o.clip.yaml --overwrite",
    "convert to a rig": "convert pair.usda o.rig.yaml --overwrite",
    "convert --physics": "convert hero.rig.yaml o.usda --physics --overwrite",
    "job": "job o.batch.yaml -o o --overwrite",
    "validate --fix": "validate bad1.rig.yaml bad2.rig.yaml --fix",
}


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stage")
    make_stage(folder)
    write_pair(folder)
    rigs = [path.name for path in folder.glob("*.rig.yaml")]
    pair = next(name for name in rigs if "meshes:" in (folder / name).read_text())
    assert animtool("convert", pair, "pair.usda", cwd=folder).code == 0
    chunks = ["bake", "pair.clip.yaml", "-o", "cache.usdc", "--deform", "--chunk", "2"]
    assert animtool(*chunks, cwd=folder).code == 0
    (folder / "o").mkdir()
    (folder / "o.scene.yaml").write_text(STATES, "utf-8")
    batch = "batch: animtool/1\ninputs: [walk.bvh]\noutput: '{stem}.usdc'\n"
    (folder / "o.batch.yaml").write_text(batch, "utf-8")
    for name in ("bad1", "bad2"):
        (folder / f"{name}.rig.yaml").write_text(BAD, "utf-8")
    return folder


def content(folder: Path) -> list[Files]:
    return [files_in(folder), files_in(folder / "o")]


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_all_files_of_a_command_or_none(
    name: str,
    stage: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Callable[[str, object], None],
) -> None:
    words = COMMANDS[name].split()
    commit, placed = WrittenFile.commit, 0
    last = 0

    def placing(self: WrittenFile, *, must_be_new: bool) -> None:
        nonlocal placed
        placed += 1
        if placed == last:
            raise output_error(self.path, "the test says so")
        commit(self, must_be_new=must_be_new)

    monkeypatch.setattr(WrittenFile, "commit", placing)
    whole = shutil.copytree(stage, tmp_path / "whole")
    done = animtool(*words, cwd=whole)
    assert done.code in {0, 1}, done.stderr
    count = placed
    assert count >= 2
    assert content(whole) != content(stage)
    for last in range(1, count + 1):
        folder = shutil.copytree(stage, tmp_path / str(last))
        placed = 0
        done = animtool(*words, cwd=folder)
        assert done.code == 3, done.stderr
        assert "OUT002" in done.stderr
        assert content(folder) == content(stage)
        assert not list(folder.rglob(".animtool-*"))
    row = f"{name}: each of {count} files cannot get its name"
    record_property(FAULTS, f"{row} | OUT002 | nothing")
