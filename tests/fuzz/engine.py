"""Runs cases in processes of their own, and counts what came of them."""

from __future__ import annotations

import importlib
import json
import mmap
import os
import pkgutil
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from types import ModuleType

import numpy as np
from support.sanitized import SANITIZED

from animtool.core.process.supervisor import CRASH_SIGNALS, report_reading

Case = Callable[[np.random.Generator], str]

# A case may use this much of each, on one processor.
CPU_SECONDS = 2.0
MEMORY_BYTES = 1 << 30
# Cases of one process: what it leaks or caches ends with it.
CHUNK = 500


@dataclass(slots=True)
class Outcome:
    """What came of the cases of a target.

    Attributes:
        cases: How many were run.
        words: What the target said of them, and how often.
        findings: By number of the case, what must not happen.
    """

    cases: int = 0
    words: Counter[str] = field(default_factory=Counter)
    findings: dict[int, str] = field(default_factory=dict)


def targets() -> list[str]:
    """Return the names of the targets."""
    folder = Path(__file__).parent / "targets"
    return sorted(module.name for module in pkgutil.iter_modules([str(folder)]))


def target(name: str) -> ModuleType:
    """Import a target."""
    return importlib.import_module(f"fuzz.targets.{name}")


def generator(seed: int, case: int) -> np.random.Generator:
    """Return the random numbers of a case."""
    return np.random.default_rng([seed, case])


def fuzz(name: str, cases: int, *, seed: int = 0, first: int = 0) -> Outcome:
    """Run cases of a target, in a process that is begun anew where one ends it."""
    outcome = Outcome()
    # The case, and whether USD reads a file, whose crash would be contained.
    with mmap.mmap(-1, 9) as reached:
        case = first
        while case < first + cases:
            end = min(case + CHUNK, first + cases)
            case = _chunk(name, seed, case, end, reached, outcome)
    outcome.cases = cases
    return outcome


def _chunk(
    name: str, seed: int, first: int, end: int, reached: mmap.mmap, outcome: Outcome
) -> int:
    """Run cases in a child; return the one to go on with."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    said = folder / "said.json"
    reached[:] = first.to_bytes(9, "little")
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if not child:
        code = 1
        try:
            _run(name, seed, range(first, end), folder / "work", said, reached)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if said.exists():
        words, findings = json.loads(said.read_text("utf-8"))
        outcome.words.update(words)
        outcome.findings.update({int(n): text for n, text in findings.items()})
    shutil.rmtree(folder, ignore_errors=True)
    if status == 0:
        return end
    last = int.from_bytes(reached[:8], "little")
    if reached[8] and -status in CRASH_SIGNALS:
        outcome.words[f"USD crashes: {signal.Signals(-status).name}"] += 1
        return last + 1
    ended = f"exit {status}" if status > 0 else signal.Signals(-status).name
    if status == -signal.SIGPROF:
        ended = f"took more than {CPU_SECONDS:g} s of CPU"
    outcome.findings[last] = f"crash: {ended}"
    return last + 1


def _run(
    name: str, seed: int, cases: range, folder: Path, said: Path, reached: mmap.mmap
) -> None:
    folder.mkdir()
    run: Case = target(name).make(folder)
    words: Counter[str] = Counter()
    findings: dict[int, str] = {}
    # A sanitizer takes terabytes of addresses and several times as long.
    seconds = CPU_SECONDS * (10 if SANITIZED else 1)
    if not SANITIZED:
        _limit_memory()

    def note(path: str) -> None:
        reached[8] = bool(path)

    report_reading(note)
    # What numpy warns of would reach the user's terminal.
    warnings.simplefilter("error", RuntimeWarning)
    for case in cases:
        reached[:] = case.to_bytes(9, "little")
        # Without a handler, its signal ends the process.
        signal.setitimer(signal.ITIMER_PROF, seconds)
        try:
            with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                words[run(generator(seed, case))] += 1
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}:{place.lineno}"
            findings[case] = f"{type(error).__name__}: {str(error)[:200]} ({where})"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        if case % 50 == 0 or case in findings:
            said.write_text(json.dumps([words, findings]), "utf-8")
    said.write_text(json.dumps([words, findings]), "utf-8")


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def once(name: str, case: int, *, seed: int = 0) -> str:
    """Run one case here, so that a debugger or a traceback shows it."""
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-{case}-"))
    sys.stderr.write(f"its files are in {folder}\n")
    run: Case = target(name).make(folder)
    return run(generator(seed, case))
