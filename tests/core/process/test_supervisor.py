"""What a process does about crashes and signals of the one that works for it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.spawn import get_preparation_data
from pathlib import Path
from types import ModuleType

import pytest

from animtool.core.process.supervisor import without_main

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")

# How long a process and its child may take [s].
TIMEOUT = 60.0
SCRIPT = """
import os, signal, sys
from pathlib import Path
from animtool.core.process import supervisor
from animtool.core.errors import FormatError
from animtool.core.files.leftovers import remove_leftovers
from animtool.core.files.output import replacement_path
from animtool.core.process.signals import TerminatedError, unblock_signals

def crash():
    os.kill(os.getpid(), signal.SIGSEGV)

def refuse(crash):
    print(f"refused {crash.name} {crash.path}")
    return 70

def clean(folders, process):
    remove_leftovers(map(Path, folders), process)

def work():
    unblock_signals()
    try:
        return child()
    except FormatError as error:
        print(error.code, error.faults[0].path)
        return 3
    except TerminatedError:
        return 143
"""
LAST = """
code = supervisor.supervise(work, refuse, clean)
sys.stdout.flush()
os._exit(code)
"""


@contextmanager
def started(child: str, *, before: str = "") -> Iterator[subprocess.Popen[str]]:
    """Start a process whose child does something; both end with the block, or in time.

    What is awaited of a process that is killed comes to its end, and the test fails.
    """
    with subprocess.Popen(
        [sys.executable, "-P", "-c", f"{SCRIPT}{before}\n{child}{LAST}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
    ) as process:

        def end() -> None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)

        timer = threading.Timer(TIMEOUT, end)
        timer.start()
        try:
            yield process
        finally:
            timer.cancel()
            end()


def run(child: str, stdin: str = "", *, before: str = "") -> tuple[int, str]:
    """Return the code and the words of such a process; it has no complaint."""
    with started(child, before=before) as process:
        out, err = process.communicate(stdin)
    assert err == ""
    return process.returncode, out


def test_a_file_that_crashes_is_refused_by_a_second_run() -> None:
    child = """
def child():
    for name in supervisor.stdin_lines():
        with supervisor.reading_file(Path(name)):
            if name == "bad.usda":
                crash()
    return 0
"""
    assert run(child, "good.usda\nbad.usda") == (3, "USD160 bad.usda\n")


def test_a_crash_over_no_file_is_told() -> None:
    child = """
def child():
    with supervisor.reading_file(Path("whole.usda")):
        pass
    os.abort()
"""
    assert run(child) == (70, "refused SIGABRT \n")


def test_what_was_said_is_not_said_twice() -> None:
    child = """
def child():
    print("once")
    supervisor.record_output()
    with supervisor.reading_file(Path("bad.usda")):
        crash()
"""
    assert run(child) == (70, "once\nrefused SIGSEGV bad.usda\n")


def test_what_a_crashed_child_began_to_write_is_removed(tmp_path: Path) -> None:
    child = f"""
def child():
    with replacement_path(Path({str(tmp_path / "o.usda")!r})) as temporary:
        temporary.write_text("half")
        crash()
"""
    assert run(child) == (70, "refused SIGSEGV \n")
    assert list(tmp_path.iterdir()) == []


def test_a_signal_goes_on_to_the_child_and_only_the_first_counts() -> None:
    child = """
def child():
    try:
        os.kill(os.getppid(), signal.SIGTERM)
        while True:
            pass
    finally:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        print("cleaned up")
"""
    assert run(child) == (143, "cleaned up\n")


@pytest.mark.slow
def test_a_child_that_does_not_obey_is_killed(tmp_path: Path) -> None:
    child = f"""
def child():
    with replacement_path(Path({str(tmp_path / "o.usda")!r})) as temporary:
        temporary.write_text("half")
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        os.kill(os.getppid(), signal.SIGINT)
        while True:
            pass
"""
    assert run(child, before="supervisor.GRACE_SECONDS = .05") == (130, "")
    assert list(tmp_path.iterdir()) == []


def test_a_child_ends_with_its_parent(tmp_path: Path) -> None:
    path = tmp_path / "ended"
    child = f"""
def child():
    try:
        os.kill(os.getppid(), signal.SIGKILL)
        while True:
            pass
    finally:
        Path({str(path)!r}).touch()
"""
    # The pipes close when the child has ended too.
    assert run(child) == (-signal.SIGKILL, "")
    assert path.exists()


def test_a_stop_holds_both_until_they_may_go_on() -> None:
    child = """
def child():
    os.kill(os.getppid(), signal.SIGTSTP)
    sys.stdin.read()
    return 7
"""
    with started(child) as process:
        _, status = os.waitpid(process.pid, os.WUNTRACED)
        assert os.WIFSTOPPED(status)
        os.kill(process.pid, signal.SIGCONT)
        process.communicate("")
    assert process.returncode == 7


def test_a_child_that_fails_shows_where() -> None:
    with started("def child():\n    raise ZeroDivisionError") as process:
        _, err = process.communicate("")
    assert process.returncode == 1
    assert "ZeroDivisionError" in err


def test_processes_do_not_run_the_script_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "script.py"
    main = ModuleType("__main__")
    main.__file__ = str(script)
    monkeypatch.setitem(sys.modules, "__main__", main)
    assert get_preparation_data("it")["init_main_from_path"] == str(script)
    with without_main():
        assert not get_preparation_data("it").keys() & {
            "init_main_from_path",
            "init_main_from_name",
        }
    assert sys.modules["__main__"] is main


def test_threads_start_processes_at_the_same_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    main = ModuleType("__main__")
    main.value = [1]  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "__main__", main)
    one, other = without_main(), without_main()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    hidden = sys.modules["__main__"]
    assert hidden is not main
    assert vars(hidden)["value"] is vars(main)["value"]
    other.__exit__(None, None, None)
    assert sys.modules["__main__"] is main
