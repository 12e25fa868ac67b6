"""A copy of the tree with an environment of its own: where mutants are planted and run.

Subprocesses of tests see the mutant as the tests do: they run the copy's own Python.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mutation.mutants import Result

HERE = Path(__file__).parent
# A test that takes longer than this many times what it took, and these seconds, hangs.
LIMIT_FACTOR, LIMIT_SECONDS = 20, 60
POLL_SECONDS = 0.2
# pytest's exit codes.
PASSED, NO_TESTS, BAD_USAGE = 0, 5, 4
# What is told in place of a test where none began.
BEFORE_TESTS = "collection"
INSTALLED = ("animtool", "mypy", "openjd", "pre-commit", "pytest", "ruff")


class RunError(Exception):
    """pytest could not be run at all."""


@dataclass(frozen=True, slots=True)
class Run:
    """What came of a run of pytest.

    Attributes:
        failed: Whether a test failed, or the process did.
        test: The last test that began; without any, the error that kept it from that.
        hung: Whether that was stopped for its time.
        crashed: Whether a signal ended the process, as of memory that is not its own.
        ran: How many tests began.
    """

    failed: bool
    test: str
    hung: bool
    crashed: bool
    ran: int


class Copy:
    """A copy of the checkout in a folder, which may hold an older copy.

    Attributes:
        root: The copy, with the compiled kernels in its package.
        source: The checkout.
        python: The Python of the copy's environment.
    """

    def __init__(self, source: Path, folder: Path) -> None:
        self.source = source
        self.root = folder / "tree"
        self.scratch = folder / "scratch"
        self._texts: dict[str, str] = {}
        self.python = self.root / ".venv/bin/python"
        self._second = 0
        self._copy_files()
        if not self.python.exists():
            self._make_environment()
        for name in ("plugin", "recording"):
            shutil.copyfile(HERE / f"{name}.py", self._packages / f"mutation_{name}.py")

    @property
    def _packages(self) -> Path:
        return next((self.root / ".venv/lib").glob("python*/site-packages"))

    def _copy_files(self) -> None:
        """Take over the tracked files and the new ones, and drop what is no more."""
        command = ["git", "ls-files", "-z", "-co", "--exclude-standard"]
        listed = subprocess.run(
            command, cwd=self.source, check=True, capture_output=True, text=True
        )
        names = {Path(name) for name in listed.stdout.split("\0") if name}
        names = {name for name in names if (self.source / name).is_file()}
        for folder in ("animtool", "tests", "rigs", "samples"):
            for path in (self.root / folder).rglob("*"):
                if path.is_file() and path.relative_to(self.root) not in names:
                    path.unlink()
        for name in names:
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(self.source / name, self.root / name)
        kernels = importlib.util.find_spec("animtool._kernels")
        if kernels is None or kernels.origin is None:
            raise RunError("animtool is not installed: its kernels are not found")
        if any("_editable" in type(finder).__module__ for finder in sys.meta_path):
            raise RunError("animtool is installed with -e: copies would import that")
        shutil.copy2(kernels.origin, self.root / "animtool")

    def _make_environment(self) -> None:
        """Make an environment: the copy first, then what is installed here."""
        venv.create(self.root / ".venv", symlinks=True, with_pip=False)
        packages = sysconfig.get_path("purelib")
        lines = (
            str(self.root),
            f"import site; site.addsitedir({packages!r})",
            "import os; 'MUTATION_COVER' in os.environ and "
            "__import__('mutation_recording').start()",
        )
        (self._packages / "mutation.pth").write_text("\n".join(lines) + "\n")
        for name in INSTALLED:
            script = Path(sys.executable).parent / name
            if script.exists():
                copy = self.python.parent / name
                shutil.copy2(script, copy)
                head, _, rest = copy.read_bytes().partition(b"\n")
                if b"python" in head and head.startswith(b"#!"):
                    copy.write_bytes(f"#!{self.python}\n".encode() + rest)

    def text(self, path: str) -> str:
        """Return a file as it was when it was copied: the checkout may have changed."""
        if path not in self._texts:
            self._texts[path] = (self.root / path).read_text("utf-8")
        return self._texts[path]

    def plant(self, path: str, text: str) -> None:
        """Write a file of the copy; no bytecode of an older text fits it."""
        file = self.root / path
        file.unlink()
        file.write_text(text, "utf-8")
        # Later than of any text before, in this run and in older ones.
        self._second = max(self._second + 1, int(file.stat().st_mtime))
        second = self._second
        os.utime(file, (second, second))
        for compiled in file.parent.glob(f"__pycache__/{file.stem}.*"):
            compiled.unlink()

    def restore(self, path: str) -> None:
        """Write a file as it was copied."""
        self.plant(path, self.text(path))

    def run(self, tests: Sequence[str], seconds: Mapping[str, float]) -> Run:
        """Run tests in their order until one fails or hangs.

        Args:
            tests: Their names. Those of files that are no more are left out.
            seconds: What each takes otherwise.
        """
        files = list(dict.fromkeys(name.partition("::")[0] for name in tests))
        files = [name for name in files if (self.root / name).exists()]
        if not files:
            return Run(False, "", False, False, 0)
        # What outlives a run may still write there: each has a folder of its own.
        shutil.rmtree(self.scratch, ignore_errors=True)
        self.scratch.mkdir(exist_ok=True)
        folder = Path(tempfile.mkdtemp(dir=self.scratch))
        (folder / "tmp").mkdir()
        chosen, progress = folder / "tests.json", folder / "progress"
        chosen.write_text(json.dumps(list(tests)))
        progress.write_text("")
        environment = os.environ | {
            "MUTATION_TESTS": str(chosen),
            "MUTATION_PROGRESS": str(progress),
            "TMPDIR": str(folder / "tmp"),
            "HYPOTHESIS_STORAGE_DIRECTORY": str(folder / "hypothesis"),
        }
        command = [self.python, "-P", "-m", "pytest", "-x", "-q", "-n0", "--tb=line"]
        command += ["-p", "mutation_plugin", "-p", "no:cacheprovider"]
        command += ["--hypothesis-seed=0", *files]
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(
                command,
                cwd=self.root,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                hung = self._watch(process, progress, seconds)
            finally:
                _end(process)
        begun = _begun(progress)
        last = begun[-1] if begun else ""
        if process.returncode == BAD_USAGE:
            said = (folder / "log").read_text("utf-8", "replace")
            # Of a bug that breaks the imports of conftest.py pytest says so.
            if "while loading conftest" not in said:
                raise RunError(said)
        failed = process.returncode not in (PASSED, NO_TESTS)
        shutil.rmtree(folder / "tmp", ignore_errors=True)
        crashed = process.returncode < 0 and not hung
        if failed and not begun:
            lines = (folder / "log").read_text("utf-8", "replace").split("\n")
            errors = [line for line in lines if line.startswith(("E ", "ERROR"))]
            last = f"{BEFORE_TESTS}: {' '.join(errors[-1:])[:200]}"
        return Run(failed, last, hung, crashed, len(begun))

    @staticmethod
    def _watch(
        process: subprocess.Popen[bytes], progress: Path, seconds: Mapping[str, float]
    ) -> bool:
        """Wait for pytest; return whether a test, or the collection, hangs."""
        count, since = -1, time.monotonic()
        while True:
            try:
                process.wait(POLL_SECONDS)
            except subprocess.TimeoutExpired:
                pass
            else:
                return False
            begun = _begun(progress)
            if len(begun) != count:
                count, since = len(begun), time.monotonic()
            usual = seconds.get(begun[-1], 0.0) if begun else LIMIT_SECONDS
            if time.monotonic() - since > LIMIT_SECONDS + LIMIT_FACTOR * usual:
                return True


def _begun(progress: Path) -> list[str]:
    """Return the tests that began."""
    text = progress.read_text("utf-8")
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def _end(process: subprocess.Popen[bytes]) -> None:
    """End pytest and what it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def judge(
    copy: Copy, stages: Sequence[Sequence[str]], seconds: Mapping[str, float], left: int
) -> Result:
    """Return what becomes of the mutant in a copy: stages of tests, until one fails."""
    begun, ran = time.monotonic(), 0
    count = sum(map(len, stages)) + left
    for stage in stages:
        run = copy.run(stage, seconds)
        ran += run.ran
        took = round(time.monotonic() - begun, 1)
        if run.failed or run.hung:
            outcome = "crashed" if run.crashed else "killed"
            outcome = "timed out" if run.hung else outcome
            return Result(outcome, run.test, count, ran, left, took)
    took = round(time.monotonic() - begun, 1)
    return Result("survived" if count else "uncovered", "", count, ran, left, took)
