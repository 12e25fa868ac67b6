"""Modules that a command runs, in order, and pairs that call each other both ways.

python -m support.modules_run bake samples/walk/walk.bvh -o /tmp/walk.usdc
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import FrameType

# Flag of code that is no body of a module or class, which run as it is imported.
FUNCTION = 1
COMPREHENSIONS = {"<genexpr>", "<listcomp>", "<setcomp>", "<dictcomp>"}


class Calls:
    """Counts calls between modules of animtool."""

    def __init__(self) -> None:
        self.modules: dict[str, str] = {}  # first function called, by module
        self.calls: set[tuple[str, str]] = set()

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Note a call."""
        if event != "call":
            return
        name = frame.f_globals.get("__name__", "")
        # The body of a module, and of a class, runs when it is imported.
        if not name.startswith("animtool") or frame.f_code.co_name.startswith(
            "<module"
        ):
            return
        if not frame.f_code.co_flags & 1:  # a body of a class is not optimised
            return
        caller = frame.f_back
        # A comprehension in the body of a module is part of it.
        is_comprehension = frame.f_code.co_name in COMPREHENSIONS
        if is_comprehension and caller and not caller.f_code.co_flags & FUNCTION:
            return
        self.modules.setdefault(name, frame.f_code.co_name)
        while caller is not None:
            other = caller.f_globals.get("__name__", "")
            if other.startswith("animtool"):
                if other != name and caller.f_code.co_flags & FUNCTION:
                    self.calls.add((other, name))
                return
            caller = caller.f_back

    @property
    def both_ways(self) -> list[tuple[str, str]]:
        """Pairs of modules that call each other."""
        pairs = {tuple(sorted(pair)) for pair in self.calls if pair[::-1] in self.calls}
        return sorted((a, b) for a, b in pairs)


def counted(arguments: Sequence[str]) -> Calls:
    """Return what a command line calls."""
    from animtool.cli.main import run

    calls = Calls()
    sys.setprofile(calls)
    try:
        run(arguments)
    except SystemExit:
        pass
    finally:
        sys.setprofile(None)
    return calls


if __name__ == "__main__":
    found = counted(sys.argv[1:])
    pairs = [" ".join(pair) for pair in found.both_ways]
    head = f"{len(found.modules)} modules, {len(pairs)} pairs both ways"
    modules = [f"{name}: {function}" for name, function in found.modules.items()]
    sys.stdout.write("\n".join([head, *pairs, "", *modules, ""]))
