"""Ends for want of memory or from outside: exit 3, and what needed it."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.cli import TIMEOUT, animtool

from animtool.cli.main import crash_reason, is_out_of_memory, memory_fault

LIMITED = "ulimit -v {kib} && exec {python} -P -m animtool {words}"


@pytest.mark.parametrize(
    ("error", "is_memory"),
    [
        (MemoryError(), True),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), True),
        (ImportError("lib.so: failed to map segment from shared object"), True),
        (RuntimeError("can't start new thread"), True),
        (RuntimeError("std::bad_alloc"), True),
        (OSError(errno.ENOENT, "missing"), False),
        (ImportError("no module named a"), False),
        (ValueError("std::bad_alloc"), False),
    ],
)
def test_which_errors_are_for_want_of_memory(error: Exception, is_memory: bool) -> None:
    assert is_out_of_memory(error) is is_memory
    outer = KeyError("a")
    outer.__cause__ = error
    assert is_out_of_memory(outer) is is_memory


def test_the_fault_names_what_needed_how_much() -> None:
    from animtool.maths.so3 import log

    class Huge:
        shape = (3,)

        def __array__(self, dtype: object = None, copy: object = None) -> object:
            return np.zeros(2**59)

    with pytest.raises(MemoryError) as raised:
        log(Huge())  # type: ignore[arg-type]
    fault = memory_fault(raised.value)
    assert fault.code == "IO013"
    assert "4.00 EiB" in fault.message
    assert "maths." in fault.message


def test_a_command_without_memory_is_no_fault_of_its_own(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> object:
        raise MemoryError("Unable to allocate 8.00 GiB for an array")

    monkeypatch.setattr("animtool.report.describe.describe", full)
    monkeypatch.setattr("animtool.formats.bvh.read.open_bvh", full, raising=False)
    monkeypatch.setattr("animtool.formats.bvh.read.read_bvh", full)
    monkeypatch.setattr("animtool.cli.info.describe", full, raising=False)
    done = animtool("info", walk)
    assert done.code == 3
    assert "IO013" in done.stderr
    assert "8.00 GiB" in done.stderr
    assert (
        "This is a bug in animtool or in a library. Please report it."
        not in done.stderr
    )


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_a_limit_of_memory_is_named(walk: Path, tmp_path: Path) -> None:
    words = f"bake {walk} -o {tmp_path / 'o.usda'}"
    script = LIMITED.format(kib=300_000, python=sys.executable, words=words)
    done = subprocess.run(
        ["sh", "-c", script],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    assert done.returncode == 3, done.stderr
    assert "IO013" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_kill_from_outside_is_not_the_files_fault() -> None:
    fault = crash_reason("SIGKILL", "a.usda")
    assert fault is not None
    assert (fault.code, fault.path) == ("IO014", "a.usda")
    assert crash_reason("SIGSEGV") is None


KILLED = """
import os, signal, sys
import animtool.cli.main as main
def killed(arguments):
    os.kill(os.getpid(), signal.SIGKILL)
main.run = killed
main.main(["info", "a.bvh"])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_command_whose_process_is_killed() -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-c", KILLED],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    assert done.returncode == 3
    assert "IO014" in done.stderr
    assert "a time limit" in done.stderr


LOADING = """
import os, signal, sys
sys.argv[0] = "/bin/animtool"
import animtool
assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
os.kill(os.getpid(), signal.SIGINT)
"""


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_an_interrupt_while_the_command_loads_has_no_traceback() -> None:
    command = [sys.executable, "-P", "-c", LOADING]
    done = subprocess.run(command, capture_output=True, check=False, timeout=TIMEOUT)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, b"")
    other = LOADING.replace("/bin/animtool", "/bin/other").replace(
        "SIG_DFL", "default_int_handler"
    )
    command = [sys.executable, "-P", "-c", other]
    done = subprocess.run(command, capture_output=True, check=False, timeout=TIMEOUT)
    assert b"KeyboardInterrupt" in done.stderr
