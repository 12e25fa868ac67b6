"""Runs a sample of mutants in copies of the tree, and goes on where it was stopped.

A language is a module with these names; `python.py` and `cpp.py` are the two.

``packages(root)``
    The packages, and the files of each.
``edits(source)``
    The bugs of a file.
``valid(source)``
    Whether a file with a bug is worth building.
``Tests(root, state)``
    What finds tests: called with a mutant it returns the tests that run its line. Its
    ``seconds`` are what each test takes, its ``unfit`` what fails without any bug.
``plant(copy, mutant, text)``
    Writes and builds the mutant in a copy; returns why it does not build, or nothing.
``restore(copy, mutant)``
    Makes the copy as the checkout is.
``size(lines)``
    How many mutants to draw of a package with so many lines that hold one.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from types import ModuleType
from typing import Protocol

from mutation.copies import Copy, RunError, judge
from mutation.mutants import Mutant, Result, Results, draw, mutants_of

# Tests of one mutant may take this long together, by what they took without it.
BUDGET_SECONDS = 300.0


# Folders of tests of kernels whose folder has another name.
KERNEL_TESTS = {
    "colliders": ["tests/sim/"],
    "crowds": ["tests/systems/flocks/"],
    "curves": ["tests/clip/", "tests/maths/"],
    "kinematics": ["tests/maths/", "tests/rig/"],
    "particles": ["tests/systems/molecules/", "tests/systems/nbody/"],
    "springs": ["tests/systems/attach/"],
}


class Finder(Protocol):
    """Finds the tests of a mutant."""

    seconds: Mapping[str, float]
    unfit: set[str]

    def __call__(self, mutant: Mutant) -> set[str]:
        """Return the tests that run a mutant's line."""


def sample(
    language: ModuleType,
    root: Path,
    packages: Sequence[str] = (),
    *,
    seed: int = 0,
    count: int | None = None,
) -> list[Mutant]:
    """Return the sample of a language, of some packages or of all.

    Args:
        language: Its module.
        root: The checkout.
        packages: The names of those to sample; all of them without any.
        seed: Another one draws another sample.
        count: How many to draw of each package, for the usual number.
    """
    drawn = []
    for name, files in language.packages(root).items():
        if packages and name not in packages:
            continue
        lines, texts = [], {}
        for file in files:
            path = str(file.relative_to(root))
            texts[path] = text = file.read_text("utf-8")
            lines += mutants_of(name, path, text, language.edits(text))

        def valid(mutant: Mutant, texts: Mapping[str, str] = texts) -> bool:
            return bool(language.valid(mutant.edit.apply(texts[mutant.path])))

        size = language.size(len(lines)) if count is None else count
        drawn += draw(lines, size, seed, valid)
    return drawn


def own(mutant: Mutant, tests: Iterable[str]) -> set[str]:
    """Return the tests of a mutant's package, and the doctests of its module.

    Those of the kernels are in the folder of their name, too: of `kernels/ik` in
    `tests/kernels`, `tests/ik` and `tests/systems/ik`.
    """
    folders = [f"tests/{mutant.package}/"]
    if mutant.package == "kernels":
        name = Path(mutant.path).parent.name
        folders += [f"tests/{name}/", f"tests/systems/{name}/"]
        folders += KERNEL_TESTS.get(name, [])
    return {name for name in tests if name.startswith((*folders, mutant.path))}


def stages(
    mutant: Mutant,
    tests: Iterable[str],
    seconds: Mapping[str, float],
    budget: float = BUDGET_SECONDS,
) -> tuple[list[list[str]], int]:
    """Return the tests of a mutant in their order, and how many are left out.

    First those of the mirrored file and the doctests of the module, then those of the
    package, then the rest; the files of each stage by what a test of theirs takes. The
    rest ends where the budget does.
    """
    parts = Path(mutant.path).with_suffix("").parts[1:]
    near = {f"tests/{'/'.join((*parts[:-1], 'test_' + parts[-1]))}.py", mutant.path}
    folder = f"tests/{parts[0]}/"
    by_file: dict[str, list[str]] = {}
    for name in tests:
        by_file.setdefault(name.partition("::")[0], []).append(name)

    def stage(file: str) -> int:
        return 0 if file in near else 1 if file.startswith(folder) else 2

    def mean(file: str) -> float:
        own = by_file[file]
        return sum(seconds.get(name, 0.0) for name in own) / len(own)

    chosen: list[list[str]] = [[], [], []]
    spent, left = 0.0, 0
    for file in sorted(by_file, key=lambda file: (stage(file), mean(file), file)):
        for name in sorted(
            by_file[file], key=lambda name: (seconds.get(name, 0.0), name)
        ):
            spent += seconds.get(name, 0.0)
            if spent > budget:
                left += 1
            else:
                chosen[stage(file)].append(name)
    return [names for names in chosen if names], left


def run(
    language: ModuleType,
    mutants: Iterable[Mutant],
    find: Finder,
    copies: Sequence[Copy],
    results: Results,
    tell: Callable[[Mutant, Result], None],
    *,
    budget: float = BUDGET_SECONDS,
    only_own: bool = False,
) -> None:
    """Run mutants, as many side by side as there are copies, and keep each result."""
    free: queue.SimpleQueue[Copy] = queue.SimpleQueue()
    for copy in copies:
        free.put(copy)
    finding = threading.Lock()

    def one(mutant: Mutant) -> tuple[Mutant, Result]:
        with finding:
            tests = find(mutant) - find.unfit
        if only_own:
            tests = own(mutant, tests)
        chosen, left = stages(mutant, tests, find.seconds, budget)
        if not chosen:
            return mutant, Result("uncovered", tests=left, left=left)
        copy = free.get()
        try:
            text = copy.text(mutant.path)
            if text.split("\n")[mutant.edit.line - 1].strip() != mutant.before:
                raise RunError(f"{mutant.path} changed while it was copied")
            fault = language.plant(copy, mutant, mutant.edit.apply(text))
            if fault:
                return mutant, Result("invalid", fault)
            return mutant, judge(copy, chosen, find.seconds, left)
        finally:
            language.restore(copy, mutant)
            free.put(copy)

    pool = ThreadPoolExecutor(len(copies))
    try:
        for judged in as_completed([pool.submit(one, mutant) for mutant in mutants]):
            mutant, result = judged.result()
            results.add(mutant, result)
            tell(mutant, result)
    finally:
        pool.shutdown(cancel_futures=True)
