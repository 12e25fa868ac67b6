"""A bake that is stopped, or runs out of room, leaves nothing half-written."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf
from support.bvh import random_rows, small_bvh
from support.cli import TIMEOUT, animtool, killable

from animtool.core.files.commit import WrittenFile
from animtool.core.files.leftovers import roll_back_folder

TRIES = 10


@pytest.fixture(scope="module")
def long_take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a take that takes a moment."""
    path = tmp_path_factory.mktemp("take") / "long.bvh"
    path.write_text(small_bvh(random_rows(800)))
    return path


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_a_bake_killed_at_any_moment(tmp_path: Path) -> None:
    take = tmp_path / "short.bvh"
    take.write_text(small_bvh(random_rows(60)))

    def files(folder: Path) -> dict[str, bytes]:
        return {
            path.name: path.read_bytes()
            for path in folder.iterdir()
            if not path.name.startswith(".animtool-")
        }

    with killable(tmp_path) as run:
        words = ("bake", take, "-o", "o.usda", "--split", "--overwrite")
        template = tmp_path / "before"
        template.mkdir()
        animtool(
            "bake", take, "-o", "o.usda", "--split", "--range", "1-3", cwd=template
        )
        before = files(template)
        assert len(before) == 3
        whole = shutil.copytree(template, tmp_path / "whole")
        done = run(0, *words, cwd=whole)
        assert done.code == 0, done.stderr
        content, calls = files(whole), int(done.stdout)
        rng = np.random.default_rng(0)
        # Most of the calls author samples; the moments about the end matter as much.
        moments = [
            *rng.integers(1, calls, TRIES // 2),
            *(calls - np.linspace(500, 2500, TRIES // 2)),
        ]
        whole_ones = 0
        for i, moment in enumerate(moments):
            folder = shutil.copytree(template, tmp_path / str(i))
            done = run(int(moment), *words, cwd=folder)
            assert done.code in {0, -signal.SIGKILL}
            # The next command that writes to the folder does so.
            roll_back_folder(folder)
            found = files(folder)
            assert found in (before, content)
            whole_ones += found == content
    assert 0 < whole_ones < TRIES


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_bake_asked_to_stop_cleans_up(
    long_take: Path, tmp_path: Path, number: signal.Signals
) -> None:
    output = tmp_path / "o.usdc"
    # The child stops itself in the middle of its work, at a place that is known.
    script = (
        "import os, signal, sys\n"
        "from animtool.usd.layers import sdf\n"
        "from animtool.cli.main import run\n"
        "save = sdf.save_layer\n"
        "def stop(layer, path):\n"
        "    open(path.with_name('.half.tmp'), 'w').close()\n"
        "    os.unlink(path.with_name('.half.tmp'))\n"
        f"    os.kill(os.getpid(), {int(number)})\n"
        "    return save(layer, path)\n"
        "sdf.save_layer = stop\n"
        f"sys.exit(run(['bake', {str(long_take)!r}, '-o', {str(output)!r}]))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", script],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    assert done.returncode == (130 if number == signal.SIGINT else 143)
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


# A limit on the size of files fails writes as a full disk does.
LIMITED = """
import contextlib, io, json, resource, signal, sys
from animtool.cli.main import run

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
for line in sys.stdin:
    limit, *words = json.loads(line)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, most))
    with contextlib.redirect_stderr(io.StringIO()) as said:
        code = run(words)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    print(json.dumps([code, said.getvalue()]))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX file size limits")
def test_a_full_disk(long_take: Path, tmp_path: Path) -> None:
    cases = [(n, f"o{end}") for n in (0, 20_000, 100_000) for end in (".usda", ".usdc")]
    lines = [[limit, "bake", str(long_take), "-o", name] for limit, name in cases]
    done = subprocess.run(
        [sys.executable, "-P", "-c", LIMITED],
        input="\n".join(map(json.dumps, lines)),
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
        cwd=tmp_path,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == len(cases)
    for code, said in found:
        assert code == 3, said
        assert "cannot be written" in said
        assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_a_late_fault_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "bad.bvh"
    path.write_text(small_bvh(random_rows(5000)) + "1 2 3\n")
    output = tmp_path / "o.usda"
    output.write_text("mine")
    done = animtool("bake", path, "-o", output, "--overwrite")
    assert done.code == 3
    assert output.read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.bvh", "o.usda"]


def test_an_output_that_usd_has_open_is_replaced(walk: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    animtool("bake", walk, "-o", output)
    layer = Sdf.Layer.FindOrOpen(str(output))
    assert animtool("bake", walk, "-o", output, "--overwrite", "--start", "5").code == 0
    layer.Reload(force=True)
    assert layer.startTimeCode == 5


@pytest.mark.parametrize(("step", "code"), [("flush_to_disk", 130), ("commit", 0)])
def test_a_signal_about_the_naming(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, code: int
) -> None:
    do = getattr(WrittenFile, step)

    def signalled(whole: WrittenFile, **given: bool) -> None:
        do(whole, **given)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(WrittenFile, step, signalled)
    for words in (("bake", walk, "-o", "o.usda"), ("convert", walk, "o.clip.yaml")):
        folder = tmp_path / words[0]
        folder.mkdir()
        done = animtool(*words, cwd=folder)
        assert done.code == code, done.stderr
        # Either nothing is there, or all.
        assert bool(list(folder.iterdir())) == (code == 0)
