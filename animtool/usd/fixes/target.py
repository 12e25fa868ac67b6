"""The layer that fixes edit: its own values, told from those of other files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd

from animtool.errors import Fault

AnyArray = npt.NDArray[Any]
# From the arrays of an attribute, in time order, to those that replace them.
Rewrite: TypeAlias = Callable[[list[AnyArray]], list[AnyArray]]


class NotFixableError(Exception):
    """A finding whose remedy is not safe in this layer; the text says why."""


@dataclass(frozen=True, slots=True)
class Change:
    """What an edit changed.

    Attributes:
        text: The action and its counts, for the report.
        largest: Largest change of a number, None where that says nothing.
        unit: Of that number.
    """

    text: str
    largest: float | None = None
    unit: str = ""

    def __str__(self) -> str:
        if self.largest is None:
            return self.text
        return f"{self.text}; largest change {self.largest:.3g} {self.unit}".rstrip()


# Applies a fix to the layer of its target.
Edit: TypeAlias = Callable[[], Change]


@dataclass(frozen=True, slots=True)
class Target:
    """A stage, and its root layer, which alone is edited.

    Attributes:
        stage: A `Usd.Stage`.
        layer: Its root `Sdf.Layer`.
    """

    stage: Any
    layer: Any

    def prim(self, fault: Fault) -> Any:
        """Return the prim of a finding.

        Raises:
            NotFixableError: It is missing, or within an instance.
        """
        path = Sdf.Path(fault.where or "")
        prim = self.stage.GetPrimAtPath(path.GetPrimPath()) if path else None
        if not prim:
            raise NotFixableError("the prim was not found")
        if prim.IsInstanceProxy() or prim.IsInPrototype():
            raise NotFixableError("an instance cannot be changed from this layer")
        return prim

    def attribute(self, fault: Fault) -> Any:
        """Return the spec in the root layer that gives an attribute its values.

        Raises:
            NotFixableError: Another file gives them.
        """
        self.prim(fault)
        attr = self.stage.GetAttributeAtPath(fault.where)
        if not attr:
            raise NotFixableError("the attribute was not found")
        for spec in attr.GetPropertyStack(Usd.TimeCode.EarliestTime()):
            held = spec.layer.GetNumTimeSamplesForPath(spec.path)
            if held or spec.HasDefaultValue():
                self.require_own(spec)
                return spec
        raise NotFixableError("the attribute has no value")

    def prim_spec(self, prim: Any) -> Any:
        """Return the spec of a prim in the root layer.

        Raises:
            NotFixableError: Another file defines the prim.
        """
        stack = prim.GetPrimStack()
        own = [spec for spec in stack if spec.layer == self.layer]
        if own:
            return own[0]
        self.require_own(stack[0])
        return stack[0]

    def require_own(self, spec: Any) -> None:
        """Refuse a spec of another file.

        Raises:
            NotFixableError: It is one; the text names the file.
        """
        if spec.layer != self.layer:
            name = spec.layer.GetDisplayName()
            raise NotFixableError(f"the value is in {name}; fix that file")


def rewrite(spec: Any, change: Rewrite) -> tuple[int, int, float]:
    """Replace the arrays of an attribute spec, those that differ only.

    Args:
        spec: With array values, of time samples or else of the default.
        change: From all arrays to as many others of the same shapes.

    Returns:
        How many arrays differ, of how many, and the largest change of a number.

    Raises:
        NotFixableError: A sample is blocked.
    """
    layer, path = spec.layer, spec.path
    times = layer.ListTimeSamplesForPath(path)
    values = [layer.QueryTimeSample(path, t) for t in times] or [spec.default]
    if any(isinstance(value, Sdf.ValueBlock) for value in values):
        raise NotFixableError("samples are blocked")
    old = [np.array(value) for value in values]
    new = change(old)
    changed, largest = 0, 0.0
    with Sdf.ChangeBlock():
        for i, (before, after) in enumerate(zip(old, new, strict=True)):
            if np.array_equal(before, after):
                continue
            changed += 1
            apart = np.abs(after.astype(np.float64) - before)
            largest = max(largest, float(apart.max()))
            rows = np.ascontiguousarray(after.astype(before.dtype))
            made = type(values[i]).FromNumpy(rows)
            if times:
                layer.SetTimeSample(path, times[i], made)
            else:
                spec.default = made
    return changed, len(old), largest
