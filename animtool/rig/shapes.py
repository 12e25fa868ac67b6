"""Combined shapes: the order in which their weights follow from others."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter

from animtool.rig.parts import Shape

__all__ = ["ShapeCycleError", "combination_order"]


class ShapeCycleError(ValueError):
    """Shapes combine each other in a circle.

    Attributes:
        cycle: Their names, each combining the next, the first one again at the end.
    """

    def __init__(self, cycle: list[str]) -> None:
        self.cycle = cycle
        super().__init__(" → ".join(cycle))


def combination_order(shapes: Sequence[Shape]) -> list[Shape]:
    """Return shapes, each behind those that it combines.

    Raises:
        ShapeCycleError: They combine each other in a circle.

    >>> smile, both = Shape("smile"), Shape("both", combine=("smile",))
    >>> [shape.name for shape in combination_order([both, smile])]
    ['smile', 'both']
    """
    by_name = {shape.name: shape for shape in shapes}
    needs = {
        shape.name: [name for name in shape.combine if name in by_name]
        for shape in shapes
    }
    try:
        order = list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        # The sorter names each before those that need it, the other way round.
        raise ShapeCycleError(list(reversed(error.args[1]))) from error
    return [by_name[name] for name in order]
