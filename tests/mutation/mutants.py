"""Mutants: which one-line bugs a sample holds, and what became of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

# Of a mutant: its file, its line without spaces around it, that line with the bug, and
# which of the lines that read so it is.
Key = tuple[str, str, str, int]


@dataclass(frozen=True, slots=True)
class Edit:
    """A part of a line replaced: line from 1, columns, the text in its place, kind."""

    line: int
    start: int
    end: int
    text: str
    kind: str

    def apply(self, source: str) -> str:
        """Return the source with this edit."""
        lines = source.split("\n")
        line = lines[self.line - 1]
        lines[self.line - 1] = line[: self.start] + self.text + line[self.end :]
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Mutant:
    """An edit of a file. Its key outlasts changes elsewhere in the file.

    Attributes:
        package: What it is counted under.
        path: The file, relative to the root of the checkout.
        edit: Where, and what.
        before: The line, without spaces around it.
        after: The line with the bug.
        occurrence: How many lines before it in the file read the same.
    """

    package: str
    path: str
    edit: Edit
    before: str
    after: str
    occurrence: int

    @property
    def key(self) -> Key:
        """What tells this mutant from others."""
        return self.path, self.before, self.after, self.occurrence


def mutants_of(
    package: str, path: str, source: str, edits: Iterable[Edit]
) -> list[list[Mutant]]:
    """Return the mutants of a file, line by line."""
    lines = source.split("\n")
    plain = [line.strip() for line in lines]
    seen: dict[str, int] = {}
    counts = []
    for text in plain:
        counts.append(seen.get(text, 0))
        seen[text] = counts[-1] + 1
    found: dict[int, list[Mutant]] = {}
    for edit in edits:
        row, at = lines[edit.line - 1], edit.line - 1
        after = (row[: edit.start] + edit.text + row[edit.end :]).strip()
        if after != plain[at]:
            mutant = Mutant(package, path, edit, plain[at], after, counts[at])
            found.setdefault(at, []).append(mutant)
    return list(found.values())


def draw(
    lines: Sequence[Sequence[Mutant]],
    count: int,
    seed: int,
    valid: Callable[[Mutant], bool],
) -> list[Mutant]:
    """Return a sample: at most one mutant of a line, and of its kinds each as likely.

    Lines and kinds are ranked by digests of their texts, so that a change elsewhere
    replaces no more than the mutants of the lines that change.
    """

    def rank(*parts: object) -> str:
        text = json.dumps([seed, *parts])
        return hashlib.sha256(text.encode()).hexdigest()

    def of_line(mutant: Mutant) -> str:
        return rank(mutant.path, mutant.before, mutant.occurrence)

    drawn = []
    for line in sorted(lines, key=lambda line: of_line(line[0])):
        if len(drawn) == count:
            break
        ranked = sorted(
            line,
            key=lambda one: (rank(*one.key[:2], one.edit.kind), rank(*one.key)),
        )
        mutant = next((one for one in ranked if valid(one)), None)
        if mutant is not None:
            drawn.append(mutant)
    return drawn


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a mutant.

    Attributes:
        outcome: ``killed``, ``crashed``, ``timed out``, ``survived``, ``uncovered`` (no
            test runs its line) or ``invalid`` (it does not build).
        test: The test that killed it, or why it is invalid.
        tests: How many tests run its line.
        ran: How many of them were run.
        left: How many were left out, for what all of them take.
        seconds: What the run took.
    """

    outcome: str
    test: str = ""
    tests: int = 0
    ran: int = 0
    left: int = 0
    seconds: float = 0.0


KILLED = {"killed", "crashed", "timed out"}
SURVIVED = {"survived", "uncovered"}


class Results:
    """What became of mutants, in a file that each result is appended to at once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: dict[Key, Result] = {}
        for text in path.read_text("utf-8").splitlines() if path.exists() else ():
            row = json.loads(text)
            key = tuple(row.pop("mutant"))
            self._rows[key] = Result(**row)

    def get(self, mutant: Mutant) -> Result | None:
        """Return the last result of a mutant, None without one."""
        return self._rows.get(mutant.key)

    def add(self, mutant: Mutant, result: Result) -> None:
        """Append a result."""
        self._rows[mutant.key] = result
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"mutant": mutant.key, **asdict(result)}) + "\n")


def read_unfit(state: Path) -> set[str]:
    """Return the tests that fail without any mutant."""
    path = state / "unfit.json"
    return set(json.loads(path.read_text("utf-8"))) if path.exists() else set()


def read_equivalents(path: Path) -> dict[Key, str]:
    """Return the mutants that change nothing, and why, of a file of JSON lines."""
    rows = [json.loads(text) for text in path.read_text("utf-8").splitlines()]
    return {tuple(row["mutant"]): row["reason"] for row in rows}


@dataclass(slots=True)
class Tally:
    """Counts of one package."""

    mutants: int = 0
    killed: int = 0
    survived: int = 0
    equivalent: int = 0

    @property
    def rate(self) -> float:
        """Killed of all that are judged."""
        return self.killed / self.mutants if self.mutants else 1.0

    @property
    def rate_apart(self) -> float:
        """Killed of those that change something."""
        rest = self.mutants - self.equivalent
        return self.killed / rest if rest else 1.0


def tallies(
    sample: Iterable[Mutant], results: Results, equivalents: Mapping[Key, str]
) -> dict[str, Tally]:
    """Return the counts of what is judged, by package and of ``all``."""
    found: dict[str, Tally] = {}
    whole = Tally()
    for mutant in sample:
        result = results.get(mutant)
        if result is None or result.outcome == "invalid":
            continue
        for tally in (found.setdefault(mutant.package, Tally()), whole):
            tally.mutants += 1
            if result.outcome in KILLED:
                tally.killed += 1
            elif mutant.key in equivalents:
                tally.equivalent += 1
            else:
                tally.survived += 1
    return {**found, "all": whole}
