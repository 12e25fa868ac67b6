from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings
from support.printed import Printed, make_project
from support.suite import FAST, Collecting, slow_first

ROOT = Path(__file__).parents[1]

# As many processes as processors run tests: more threads would only wait.
# It is read when numpy is imported, here and in the processes that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What numpy warns of would reach the terminal: it is an error in the processes that
# tests start, too.
os.environ["PYTHONWARNINGS"] = "error::RuntimeWarning"

# Else every process would compile anew what it imports: those of xdist, and all that
# tests start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Nothing is cut off from power in a test: nobody waits for the disk. Tests of faults
# watch the calls all the same.
os.fsync = lambda _: None

# How long an example takes is the machine's affair; others are taken in each run.
# `--hypothesis-profile=full` takes ten times as many.
settings.register_profile("fast", deadline=None, max_examples=FAST)
settings.register_profile("full", deadline=None, max_examples=300)
settings.load_profile("fast")

# A shell lets jobs in the background ignore interrupts, and what they start too: here
# and in the processes that tests start, signals do what they usually do.
for _name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP"):
    _number = getattr(signal, _name, None)
    if _number is not None and signal.getsignal(_number) is signal.SIG_IGN:
        _usual = signal.default_int_handler if _name == "SIGINT" else signal.SIG_DFL
        signal.signal(_number, _usual)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Collecting())


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    if processes := getattr(config, "workerinput", {}).get("workercount"):
        items[:] = slow_first(items, processes)


def data_folder(name: str) -> Path | None:
    """Return a folder of ``$ANIMTOOL_DATA``, None where there is none."""
    root = os.environ.get("ANIMTOOL_DATA")
    folder = Path(root or "", name)
    return folder if root and folder.is_dir() else None


def pytest_report_header() -> str:
    return f"ANIMTOOL_DATA: {os.environ.get('ANIMTOOL_DATA') or 'not set'}"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the tables whose rows tests recorded under the table's heading."""
    tables: dict[str, list[str]] = {}
    for outcome in ("passed", "failed"):
        for report in terminalreporter.getreports(outcome):
            for heading, row in report.user_properties:
                tables.setdefault(heading, []).append(str(row))
    for heading, rows in tables.items():
        terminalreporter.write_line(heading)
        for row in sorted(rows):
            terminalreporter.write_line(row)


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def walk() -> Path:
    """The shipped walk cycle."""
    return ROOT / "samples/walk/walk.bvh"


@pytest.fixture
def workplace(tmp_path: Path) -> Path:
    """Return a project with the samples and the rigs that they name."""
    make_project(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def printed(tmp_path_factory: pytest.TempPathFactory) -> Printed:
    """Return what runs the commands of the documents, each once."""
    return Printed(tmp_path_factory)
