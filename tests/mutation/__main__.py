"""Plant one-line bugs and see which of them tests notice: python -m mutation run."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

from filelock import FileLock

from mutation.copies import BEFORE_TESTS, Copy
from mutation.cover import record
from mutation.engine import BUDGET_SECONDS, run, sample
from mutation.mutants import (
    KILLED,
    SURVIVED,
    Key,
    Mutant,
    Result,
    Results,
    Tally,
    read_equivalents,
    read_unfit,
    tallies,
)

ROOT = Path(__file__).parents[2]
EQUIVALENTS = Path(__file__).with_name("equivalent.jsonl")
LANGUAGES = ("python", "cpp")
# The least that is to be killed, of all and of each package, of what changes something.
LEAST_OF_ALL, LEAST_OF_PACKAGE = 0.9, 0.8


def main() -> int:
    """Do what the command line asks for; return 1 where too many survive."""
    given = _parser().parse_intermixed_args()
    given.state.mkdir(parents=True, exist_ok=True)
    # Two at once would plant in each other's copies.
    lock = FileLock(given.state / "lock", timeout=0)
    if given.do in {"cover", "run", "confirm"}:
        lock.acquire()
    if given.do == "cover" and given.language == "cpp":
        import_module("mutation.cpp").cover(ROOT, given.state, given.tests, given.jobs)
        return 0
    if given.do == "cover":
        copy = Copy(ROOT, given.state / "copies/cover")
        record(copy, given.state / "cover", given.tests, given.jobs)
        return 0
    results = Results(given.state / "results.jsonl")
    equivalents = read_equivalents(EQUIVALENTS)
    drawn = {name: _sample(name, given) for name in _languages(given)}
    if given.do == "run":
        copies = [Copy(ROOT, given.state / f"copies/{i}") for i in range(given.jobs)]
        for name, mutants in drawn.items():
            language = import_module(f"mutation.{name}")
            find = language.Tests(ROOT, given.state)
            due = _due(mutants, results, equivalents, find.unfit, given.only)
            run(
                language,
                due,
                find,
                copies,
                results,
                _tell,
                budget=given.budget,
                only_own=given.own,
            )
    elif given.do == "confirm":
        return _confirm(given, drawn, results)
    whole = [mutant for mutants in drawn.values() for mutant in mutants]
    if given.do == "sample":
        _print_mutants(whole)
        return 0
    _print_survivors(whole, results, equivalents)
    return _print_table(whole, results, equivalents)


def _parser() -> argparse.ArgumentParser:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    parser = argparse.ArgumentParser("python -m mutation", description=__doc__)
    parser.add_argument("do", choices=["cover", "sample", "run", "confirm", "table"])
    parser.add_argument("tests", nargs="*", help="cover: files and folders of tests")
    parser.add_argument("--state", type=Path, default=cache / "animtool-mutation")
    parser.add_argument("--language", choices=LANGUAGES, help="one of them alone")
    parser.add_argument(
        "--package", dest="packages", action="append", default=[], help="this one alone"
    )
    parser.add_argument(
        "--only", choices=["survived", "unfit"], help="run: these once more"
    )
    parser.add_argument("--seed", type=int, default=0, help="of another sample")
    parser.add_argument("--count", type=int, help="how many of each package")
    parser.add_argument(
        "--own", action="store_true", help="run: the tests of the package alone"
    )
    parser.add_argument("--budget", type=float, default=BUDGET_SECONDS)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    return parser


def _languages(given: argparse.Namespace) -> list[str]:
    there = [
        name for name in LANGUAGES if Path(__file__).with_name(f"{name}.py").exists()
    ]
    return [given.language] if given.language else there


def _sample(name: str, given: argparse.Namespace) -> list[Mutant]:
    language = import_module(f"mutation.{name}")
    return sample(language, ROOT, given.packages, seed=given.seed, count=given.count)


def _due(
    mutants: Iterable[Mutant],
    results: Results,
    equivalents: dict[Key, str],
    unfit: set[str],
    again: str | None,
) -> list[Mutant]:
    """Return the mutants without a result, or those that are to be run again."""

    def due(mutant: Mutant) -> bool:
        result = results.get(mutant)
        if result is None:
            return True
        if again == "unfit":
            return result.test in unfit
        survived = result.outcome in SURVIVED and mutant.key not in equivalents
        return again == "survived" and survived

    return [mutant for mutant in mutants if due(mutant)]


def _confirm(
    given: argparse.Namespace, drawn: dict[str, list[Mutant]], results: Results
) -> int:
    """Run the tests that killed mutants without any; one that fails then is unfit.

    Mutants that such a test killed are run again, by a later ``run --only unfit``.
    """
    copy = Copy(ROOT, given.state / "copies/0")
    mutants = [mutant for some in drawn.values() for mutant in some]
    verdicts = [result for mutant in mutants if (result := results.get(mutant))]
    killers = {row.test for row in verdicts if row.outcome in KILLED}
    killers = {name for name in killers if not name.startswith(BEFORE_TESTS)}
    unfit = read_unfit(given.state)
    left = sorted(killers - unfit)
    while (done := copy.run(left, {})).failed or done.hung:
        print(f"fails without a mutant: {done.test}")
        unfit.add(done.test)
        left = left[left.index(done.test) + 1 :]
    (given.state / "unfit.json").write_text(json.dumps(sorted(unfit)), "utf-8")
    print(f"{len(killers)} tests killed mutants, {len(killers & unfit)} of them unfit")
    return 1 if killers & unfit else 0


def _tell(mutant: Mutant, result: Result) -> None:
    where = f"{mutant.path}:{mutant.edit.line}"
    print(
        f"{result.outcome:9} {mutant.package:10} {where} {result.seconds:.0f} s, "
        f"{result.ran} of {result.tests} tests; {mutant.before} -> {mutant.after}; "
        f"{result.test}",
        flush=True,
    )


def _print_mutants(mutants: Iterable[Mutant]) -> None:
    for mutant in mutants:
        where = f"{mutant.path}:{mutant.edit.line}"
        print(f"{mutant.package:10} {mutant.edit.kind:10} {where}")
        print(f"    {mutant.before}\n    {mutant.after}")


def _print_survivors(
    mutants: Iterable[Mutant], results: Results, equivalents: dict[Key, str]
) -> None:
    for mutant in mutants:
        result = results.get(mutant)
        if result is not None and result.outcome in SURVIVED:
            where = f"{mutant.path}:{mutant.edit.line}"
            left = f", {result.left} of them not run" if result.left else ""
            why = equivalents.get(mutant.key)
            about = f"equivalent: {why}" if why else f"{result.tests} tests{left}"
            print(f"{mutant.package}: {where}: {about}")
            print(f"  - {mutant.before}\n  + {mutant.after}")


def _print_table(
    mutants: Iterable[Mutant], results: Results, equivalents: dict[Key, str]
) -> int:
    """Print the counts by package; return 1 where too few are killed."""
    table = tallies(mutants, results, equivalents)
    print(f"{'package':14} mutants  killed  survived  equivalent   rate   without")
    for name, row in table.items():
        print(
            f"{name:14} {row.mutants:7} {row.killed:7} {row.survived:9} "
            f"{row.equivalent:11} {row.rate:6.1%}   {row.rate_apart:6.1%}"
        )
    return 0 if all(_enough(name, row) for name, row in table.items()) else 1


def _enough(name: str, row: Tally) -> bool:
    return row.rate_apart >= (LEAST_OF_ALL if name == "all" else LEAST_OF_PACKAGE)


if __name__ == "__main__":
    sys.exit(main())
