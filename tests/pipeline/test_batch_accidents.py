"""What happens to a batch when items, processes, files and disks do what they may."""

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
from support.batch import take_files, trouble_files, trouble_plug_in, whole_outputs
from support.cli import TIMEOUT, Done, animtool, animtool_process, killable

from animtool.core.files.leftovers import temporary_prefix

GOOD = 8
KILLS = 3


@pytest.fixture
def plug_in(tmp_path: Path) -> dict[str, str]:
    return trouble_plug_in(tmp_path / "plug")


def run(
    folder: Path, *options: object, environment: dict[str, str] | None = None
) -> Done:
    """Run a batch of everything in ``takes``."""
    arguments = ("batch", "takes/*", "-o", "out/{stem}.usdc", "-j", 2, *options)
    return animtool_process(*arguments, cwd=folder, **(environment or {}))


def reported(done: Done) -> dict[str, dict[str, object]]:
    """Return what a report says of every item, by the name of its input."""
    report = json.loads(done.stdout)
    return {Path(entry["input"]).name: entry for entry in report["items"]}


@pytest.mark.slow(5)
@pytest.mark.skipif(sys.platform != "linux", reason="/proc, and POSIX signals")
def test_an_item_that_fails_costs_one_item(
    tmp_path: Path, plug_in: dict[str, str]
) -> None:
    takes = tmp_path / "takes"
    take_files(takes, GOOD)
    words = ["crash", "hang", "fill", "exit", "fault"]
    trouble_files(takes, words)
    (takes / "malformed.bvh").write_text("HIERARCHY\nROOT\n", "utf-8")
    options = ("--time-limit", 8, "--memory-limit", "450MB", "--format", "json")
    done = run(tmp_path, *options, environment=plug_in)
    assert done.code == 1, done.stderr
    found = reported(done)
    codes = {
        name: entry["faults"][0]["code"]  # type: ignore[index]
        for name, entry in found.items()
        if entry["status"] == "failed"
    }
    assert codes == {
        "crash0.trouble": "BAT020",
        "hang1.trouble": "BAT021",
        "fill2.trouble": "BAT022",
        "exit3.trouble": "BAT020",
        "fault4.trouble": "BAT023",
        "malformed.bvh": "BVH003",
    }
    assert "SIGSEGV" in done.stderr
    assert sum(entry["status"] == "done" for entry in found.values()) == GOOD
    assert len(whole_outputs(tmp_path / "out")) == GOOD

    # What hangs is not waited for again.
    again = reported(run(tmp_path, *options, "-n", environment=plug_in))
    redone = {name for name, entry in again.items() if entry["status"] != "skipped"}
    assert redone == set(codes)
    assert {again[name]["reason"] for name in redone} == {"failed last time"}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_a_run_killed_at_any_moment_goes_on(tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 3)

    with killable(tmp_path) as command:

        def killed(last: int, cwd: Path) -> Done:
            cwd.mkdir(exist_ok=True)
            words = ("batch", "../takes", "-o", "out/{stem}.usdc", "-j", 2)
            return command(last, *words, cwd=cwd)

        done = killed(0, tmp_path / "whole")
        assert done.code == 0, done.stderr
        whole, calls = whole_outputs(tmp_path / "whole"), int(done.stdout)
        rng = np.random.default_rng(0)
        # The moments when items are made and recorded are the last ones.
        moments = calls - rng.integers(1, calls // 3, KILLS)
        folder, stopped = tmp_path / "resumed", 0
        for moment in moments.tolist():
            code = killed(moment, folder).code
            assert code in {0, -signal.SIGKILL}
            stopped += code != 0
            if code == 0:
                assert whole_outputs(folder) == whole
                shutil.rmtree(folder)
        assert stopped >= 2
    words = ("batch", "../takes", "-o", "out/{stem}.usdc", "--executor", "serial")
    last = animtool(*words, cwd=folder)
    assert last.code == 0, last.stderr
    assert whole_outputs(folder) == whole


@pytest.mark.slow
def test_a_run_with_nothing_to_make_removes_what_dead_ones_left(tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 1)
    assert run(tmp_path).code == 0
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    left = tmp_path / "out" / f"{temporary_prefix(ended.pid)}0123.usdc"
    left.touch()
    assert run(tmp_path).code == 0
    assert not left.exists()


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.slow
def test_an_interrupt_leaves_whole_files(
    tmp_path: Path, plug_in: dict[str, str], number: signal.Signals
) -> None:
    take_files(tmp_path / "takes", 3)
    trouble_files(tmp_path / "takes", ["hang", "hang"])
    # The run interrupts itself when nothing but what hangs is left.
    script = (
        "import os, signal, sys\n"
        "from animtool.batch import run as batch_run\n"
        "from animtool.cli.main import run\n"
        "ended = batch_run._BatchRun._record_outcome\n"
        "def stop(self, outcome):\n"
        "    ended(self, outcome)\n"
        "    if len(self.reports_by_number) == 3:\n"
        f"        os.kill(os.getpid(), {int(number)})\n"
        "batch_run._BatchRun._record_outcome = stop\n"
        "sys.exit(run(['batch', 'takes/*', '-o', 'out/{stem}.usdc', '-j', '3']))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", script],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
        cwd=tmp_path,
        env={**os.environ, **plug_in},
    )
    assert done.returncode == (130 if number == signal.SIGINT else 143), done.stderr
    assert "Traceback" not in done.stderr
    assert len(whole_outputs(tmp_path / "out")) == 3
    for path in (tmp_path / "takes").glob("*.trouble"):
        path.unlink()
    again = run(tmp_path, "--format", "json", environment=plug_in)
    assert again.code == 0, again.stderr
    assert {entry["status"] for entry in reported(again).values()} == {"skipped"}


@pytest.mark.slow
def test_inputs_that_change_or_vanish_while_others_are_made(
    tmp_path: Path, plug_in: dict[str, str]
) -> None:
    takes = tmp_path / "takes"
    gone = tmp_path / "takes" / "zzz.bvh"
    trouble_files(takes, ["touch", f"vanish {gone}"])
    gone.write_bytes((tmp_path / "plug" / "good.bvh").read_bytes())
    done = run(tmp_path, "--format", "json", "-j", 1, environment=plug_in)
    assert done.code == 1, done.stderr
    codes = {
        name: [fault["code"] for fault in entry.get("faults", ())]  # type: ignore[attr-defined]
        for name, entry in reported(done).items()
    }
    assert codes == {
        "touch0.trouble": ["IO004"],
        "vanish1.trouble": [],
        "zzz.bvh": ["IO001"],
    }
    assert list(whole_outputs(tmp_path / "out")) == ["vanish1.usdc"]


LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
from animtool.cli.main import run
sys.exit(run(sys.argv[2:]))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX file size limits")
@pytest.mark.parametrize(
    ("limit", "code", "word"), [(2_000, 1, "OUT002"), (40, 3, "BAT012")]
)
def test_a_full_disk(tmp_path: Path, limit: int, code: int, word: str) -> None:
    take_files(tmp_path / "takes", 2, frames=200)
    # A limit on the size of files fails writes as a full disk does: a large one only
    # those of outputs, a small one the record too.
    arguments = ["batch", "takes", "-o", "out/{stem}.usdc", "-j", "1"]
    done = subprocess.run(
        [sys.executable, "-P", "-c", LIMITED, str(limit), *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
        cwd=tmp_path,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert done.returncode == code, done.stderr
    assert word in done.stderr
    assert "Traceback" not in done.stderr
    assert whole_outputs(tmp_path / "out") == {}
    again = animtool(*arguments, cwd=tmp_path)
    assert again.code == 0, again.stderr
    assert len(whole_outputs(tmp_path / "out")) == 2


def test_a_folder_that_may_not_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_files(tmp_path / "takes", 2)
    monkeypatch.setattr("animtool.batch.plan.os.access", lambda *_: False)
    done = animtool("batch", "takes", "-o", "out/{stem}.usdc", cwd=tmp_path)
    assert done.code == 3
    assert "OUT002" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow(1.2)
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_an_item_killed_from_outside_says_how_to_go_on(
    tmp_path: Path, plug_in: dict[str, str]
) -> None:
    trouble_files(tmp_path / "takes", [f"once {tmp_path / 'flag'}"])
    done = run(tmp_path, "--format", "json", environment=plug_in)
    assert done.code == 1, done.stderr
    ((entry,),) = [list(reported(done).values())]
    (fault,) = entry["faults"]  # type: ignore[misc]
    assert fault["code"] == "BAT020"  # type: ignore[index]
    assert "out of memory or a time limit" in fault["message"]  # type: ignore[index]
    assert "to resume" in fault["hint"]  # type: ignore[index]
    assert run(tmp_path, environment=plug_in).code == 0
