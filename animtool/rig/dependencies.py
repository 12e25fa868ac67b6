"""Dependency order of named parts of a rig, such as shapes, controls and drivers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter

from animtool.core.errors import cycle_text


class DependencyCycleError(ValueError):
    """Parts of a rig depend on each other in a cycle.

    Attributes:
        cycle: Names of the parts, each depending on the next; the first one again at
            the end.
    """

    def __init__(self, cycle: list[str]) -> None:
        self.cycle = cycle
        super().__init__(cycle_text(cycle))


def dependency_order(dependencies_by_name: Mapping[str, Iterable[str]]) -> list[str]:
    """Return names in dependency order: each after those that it depends on.

    >>> dependency_order({"both": ["smile", "jaw"]})
    ['smile', 'jaw', 'both']
    """
    try:
        return list(TopologicalSorter(dependencies_by_name).static_order())
    except CycleError as error:
        # The sorter names each part before those that need it; reverse that.
        raise DependencyCycleError(list(reversed(error.args[1]))) from error
