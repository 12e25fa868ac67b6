"""Print the lowest versions that pyproject.toml allows, as constraints of pip.

The names of extras are arguments; without them, only what animtool itself needs counts.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
_BOUND = re.compile(r"([\w.-]+)(?:\[[\w,-]+\])?\s*>=\s*([\w.]+)\s*(;.*)?")


def constraints(project: dict[str, Any], extras: Sequence[str] = ()) -> Iterator[str]:
    """Yield ``name==version`` for each dependency; raises ``ValueError`` without bound.

    Args:
        project: Table ``project`` of pyproject.toml.
        extras: Names of optional dependencies that count too.
    """
    groups = [project["dependencies"]]
    groups += [project["optional-dependencies"][name] for name in extras]
    bounds: dict[str, tuple[str, str]] = {}
    for requirement in (each for group in groups for each in group):
        bound = _BOUND.fullmatch(requirement)
        if bound is None:
            # Stubs of types have no bound, and are not imported.
            if requirement.startswith("types-"):
                continue
            raise ValueError(f"{requirement!r} has no lower bound; write NAME>=VERSION")
        name, version, marker = bound.groups()
        if bounds.setdefault(name, (version, marker or ""))[0] != version:
            raise ValueError(f"{name} has two lower bounds; write the same in both")
    for name, (version, marker) in bounds.items():
        yield f"{name}=={version}{marker}"


def main(extras: list[str]) -> int:
    """Print the constraints."""
    with PYPROJECT.open("rb") as file:
        project = tomllib.load(file)["project"]
    print(*constraints(project, extras), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
