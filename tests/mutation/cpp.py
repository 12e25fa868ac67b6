"""Mutants in the kernels: where they are, how they are built, which tests run them.

Needs cmake, ninja, g++ and binutils. Each copy has a folder where its kernels are
built: what depends on the mutant is compiled again.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from mutation.copies import Copy, RunError
from mutation.cpp_cover import Recording, record, source_files
from mutation.cpp_syntax import edits
from mutation.mutants import Mutant

__all__ = ["Tests", "edits", "packages", "plant", "restore", "size", "valid"]

FOLDER = Path("animtool/kernels")
# Names, documentation and declarations.
LEFT_OUT = "bindings"
SAMPLED = 40
RECORDINGS = "kernels"
# Tests that run kernels in other ways than through the commands.
TESTS = [
    "kernels", "maths", "rig", "ik", "skin", "clip", "edit", "formats", "fuzz", "sim",
    "conformance", "scene", "pipeline", "usd", "validation", "documents", "report",
]  # fmt: skip


def packages(root: Path) -> dict[str, list[Path]]:
    """Return the one package, and its files."""
    files = source_files(root / FOLDER)
    return {"kernels": [path for path in files if path.parent.name != LEFT_OUT]}


def valid(_source: str) -> bool:
    """Return True: what does not compile shows when it is built."""
    return True


def size(_lines: int) -> int:
    """Return how many mutants to draw."""
    return SAMPLED


def cover(root: Path, state: Path, tests: Sequence[str], jobs: int) -> None:
    """Record which tests run which lines; what was recorded before stays."""
    copy = Copy(root, state / "copies/cover")
    library = build(copy, marked=True)
    install(copy, library)
    folder = state / RECORDINGS
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{len(list(folder.iterdir())):04d}"
    record(copy, library, target, tests or [f"tests/{name}" for name in TESTS], jobs)


class Tests:
    """Finds the tests that run a line of the kernels, by what was recorded."""

    def __init__(self, root: Path, state: Path) -> None:
        self.root = root
        folder = state / RECORDINGS
        if not folder.exists():
            cover(root, state, [], 2)
        kept = [path for path in folder.iterdir() if path.suffix != ".partial"]
        self.recordings = [Recording(path) for path in sorted(kept)]
        self.seconds: dict[str, float] = {}
        self.unfit: set[str] = set()
        for recording in self.recordings:
            self.seconds |= recording.seconds
            self.unfit = self.unfit - recording.seconds.keys() | recording.failed

    def __call__(self, mutant: Mutant) -> set[str]:
        """Return the tests that run a mutant's line."""
        text = (self.root / mutant.path).read_text("utf-8")
        name, line = _name(mutant), mutant.edit.line
        found = [one.tests(name, text, line) for one in self.recordings]
        return set().union(*found)


def plant(copy: Copy, mutant: Mutant, text: str) -> str:
    """Build the kernels of a copy with a mutant; return why they do not build."""
    try:
        install(copy, build(copy, {_name(mutant): text}))
    except subprocess.CalledProcessError as error:
        faults = [line for line in error.stdout.splitlines() if " error: " in line]
        return faults[0] if faults else "it does not build"
    return ""


def restore(copy: Copy, _mutant: Mutant) -> None:
    """Put the kernels of this environment in the place of those with a mutant."""
    kernels = importlib.util.find_spec("animtool._kernels")
    assert kernels is not None
    assert kernels.origin is not None
    install(copy, Path(kernels.origin))


def build(
    copy: Copy, changed: dict[str, str] | None = None, *, marked: bool = False
) -> Path:
    """Build the kernels of the checkout, some files changed; return the library."""
    folder = copy.root.parent / ("kernels_marked" if marked else "kernels")
    source, build = folder / "source", folder / "build"
    source.mkdir(parents=True, exist_ok=True)
    # Files are written only if they differ, for ninja goes by their times.
    sources = copy.source / FOLDER
    lists = [sources / "CMakeLists.txt", *sorted(sources.glob("*/*.txt"))]
    for path in [*lists, *source_files(sources)]:
        name = path.relative_to(sources)
        text = (changed or {}).get(name.as_posix(), path.read_text("utf-8"))
        target = source / name
        target.parent.mkdir(exist_ok=True)
        if not target.exists() or target.read_text("utf-8") != text:
            target.write_text(text, "utf-8")
    if not (build / "build.ninja").exists():
        hits = Path(__file__).with_name("hits.cmake")
        options = {
            "CMAKE_PROJECT_INCLUDE": hits,
            "KERNEL_HITS": "ON" if marked else "OFF",
            "ANIMTOOL_SYMBOLS": "NOSTRIP" if marked else "",
            "Python_EXECUTABLE": sys.executable,
        }
        given = [f"-D{name}={value}" for name, value in options.items()]
        _run("cmake", "-S", source, "-B", build, "-G", "Ninja", *given)
    _run("ninja", "-C", build, "-j", "1")
    found = list(build.glob("_kernels*.so"))
    if len(found) != 1:
        raise RunError(f"kernels are not found in {build}")
    return found[0]


def install(copy: Copy, library: Path) -> None:
    """Put a library in the place of a copy's kernels, as a file of its own."""
    for old in (copy.root / "animtool").glob("_kernels*.so"):
        old.unlink()
    shutil.copy2(library, copy.root / "animtool" / library.name)


def _run(*command: str | Path) -> None:
    subprocess.run(
        command, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def _name(mutant: Mutant) -> str:
    """Return the file of a mutant as `folder/file`."""
    return Path(mutant.path).relative_to(FOLDER).as_posix()
