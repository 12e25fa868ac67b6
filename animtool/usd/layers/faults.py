"""Finds faults of Skeletons and animations, for readers and checks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from pxr import UsdGeom, Vt

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, Severity, counted, excerpt, listed
from animtool.core.record import dataclass
from animtool.core.rules import finding
from animtool.core.units import UpAxis

# Largest number of a transform, which is float32 in most files.
MAX_TRANSFORM = float(np.finfo(np.float32).max)
# Tolerance of a quaternion's length; text files with four digits are within it.
UNIT_TOLERANCE = 1e-3
# Smallest volume of a regular transform, relative to that of orthogonal axes of the
# same lengths.
MIN_VOLUME = 1e-12
# Valid range of rates and units; others would overflow what they scale.
MIN_RATE_OR_UNIT, MAX_RATE_OR_UNIT = 1e-9, 1e9
# Some exporters write names as strings.
_NAME_ARRAYS = (Vt.TokenArray, Vt.StringArray)


@dataclass(frozen=True, slots=True)
class PrimLocation:
    """Location of a fault: a file, and a prim or property in it."""

    path: str
    where: str | None = None

    @classmethod
    def from_prim(cls, path: Path | str, prim: Any) -> PrimLocation:
        """Return the location of a prim, a schema or an attribute."""
        return cls(str(path), str(prim.GetPath()))

    def at_prim(self, prim: Any) -> PrimLocation:
        """Return the location of another prim or attribute of the file."""
        return PrimLocation.from_prim(self.path, prim)

    def fault(
        self,
        code: str,
        message: str,
        hint: str | None = None,
        severity: Severity = Severity.ERROR,
    ) -> Fault:
        """Return a fault at this location."""
        return Fault(code, message, self.path, (), hint, severity, where=self.where)

    def fail(self, code: str, message: str, hint: str | None = None) -> NoReturn:
        """Raise a fault at this location as an error."""
        raise FormatError(self.fault(code, message, hint))

    def raise_errors(self, faults: Iterable[Fault]) -> None:
        """Raise faults, including warnings, as an error at this location."""
        errors = [replace(f, path=self.path, severity=Severity.ERROR) for f in faults]
        if errors:
            raise FormatError(errors)


def token_array(attr: Any) -> list[str]:
    """Return the tokens of an attribute; empty without a value or of another type."""
    value = attr.Get() if attr else None
    return list(map(str, value)) if isinstance(value, _NAME_ARRAYS) else []


def duplicate_tokens(names: Sequence[str]) -> list[str]:
    """Return the duplicate names, in order.

    >>> duplicate_tokens(["a", "b", "a", "a"])
    ['a']
    """
    return [name for name, count in Counter(names).items() if count > 1]


def joint_parents(joints: Sequence[str]) -> IntArray:
    """Return each joint's parent index as UsdSkel resolves it, -1 for a root.

    >>> joint_parents(["a", "a/b/c"]).tolist()
    [-1, 0]
    """
    joint_indices = {name: i for i, name in enumerate(joints)}

    def parent_index(name: str) -> int:
        while name := name.rpartition("/")[0]:
            if name in joint_indices:
                return joint_indices[name]
        return -1

    return np.array([parent_index(name) for name in joints], np.int64)


def unit_and_axis_faults(stage: Any) -> Iterator[Fault]:
    """Yield faults for an invalid stage unit or up axis."""
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if not MIN_RATE_OR_UNIT <= unit <= MAX_RATE_OR_UNIT:
        yield finding("USD260", "/", f"metersPerUnit is {unit:g}")
    up = str(UsdGeom.GetStageUpAxis(stage))
    if up not in list(UpAxis):
        yield finding("USD260", "/", f"upAxis is {up!r}")


def matrix_array(attr: Any) -> FloatArray:
    """Return the matrices of an attribute ``(N, 4, 4)``, row vectors as in USD."""
    value = np.array(attr.Get() or ())
    is_valid = value.dtype.kind == "f" and value.size % 16 == 0
    return np.asarray(value if is_valid else (), np.float64).reshape(-1, 4, 4)


def joint_order_faults(
    attribute_path: object, joints: Sequence[str]
) -> Iterator[Fault]:
    """Yield faults in joint paths: duplicates, or a child before its parent."""
    repeated_joints = duplicate_tokens(joints)
    if repeated_joints:
        message = f"{len(repeated_joints)} of {len(joints)} joints are duplicates: "
        message += listed(repeated_joints)
        yield finding("USD220", attribute_path, message)
        return
    parents = joint_parents(joints)
    misplaced_joints = np.flatnonzero(parents > np.arange(len(joints)))
    if len(misplaced_joints):
        child = int(misplaced_joints[0])
        message = (
            f"joint {child}, {excerpt(joints[child])}, comes before its parent, "
            f"joint {parents[child]}"
        )
        yield finding("USD221", attribute_path, message)


def bind_faults(
    skeleton: Any, joints: Sequence[str], *, is_skinned: bool
) -> Iterator[Fault]:
    """Yield faults in bind transforms; only a skinned Skeleton requires them."""
    attr = skeleton.GetBindTransformsAttr()
    bind = matrix_array(attr)
    if len(bind) != len(joints):
        if len(bind) or is_skinned:
            message = (
                f"{counted(len(bind), 'bindTransform')}"
                f" for {counted(len(joints), 'joint')}"
            )
            yield finding("USD224", attr.GetPath(), message)
        return
    faults = list(non_finite_faults(attr, bind, joints))
    yield from faults
    if faults:
        return
    singular_joints = np.flatnonzero(is_singular(bind))
    if len(singular_joints):
        names = [joints[i] for i in singular_joints.tolist()]
        message = (
            f"{len(singular_joints)} bindTransforms have no inverse: {listed(names)}"
        )
        yield finding("USD226", attr.GetPath(), message)


def is_singular(matrices: FloatArray) -> BoolArray:
    """Return which matrices ``(N, 4, 4)`` are singular."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=2).prod(axis=1)
    volumes = np.abs(np.linalg.det(linear))
    is_degenerate: BoolArray = (volumes <= MIN_VOLUME * lengths) | (lengths == 0)
    return is_degenerate


def unknown_joint_faults(
    attr: Any, joints: Sequence[str], skeleton: Any
) -> Iterator[Fault]:
    """Yield a fault if an animation has joints that its Skeleton lacks."""
    joint_set = set(joints)
    unknown_joints = [name for name in token_array(attr) if name not in joint_set]
    if unknown_joints and joint_set:
        message = (
            f"{counted(len(unknown_joints), 'joint')} that {skeleton} does not have: "
        )
        message += listed(unknown_joints)
        yield finding("USD209", attr.GetPath(), message)


def duplicate_name_faults(attr: Any) -> Iterator[Fault]:
    """Yield a fault for duplicate joints or shapes of an animation."""
    names = token_array(attr)
    repeated_names = duplicate_tokens(names)
    if repeated_names:
        message = f"{len(repeated_names)} of {len(names)} names are duplicates: "
        yield finding("USD207", attr.GetPath(), message + listed(repeated_names))


def transform_attributes(animation: Any) -> dict[str, Any]:
    """Return the attributes of a SkelAnimation that animate joints, by name."""
    return {
        "translations": animation.GetTranslationsAttr(),
        "rotations": animation.GetRotationsAttr(),
        "scales": animation.GetScalesAttr(),
    }


def missing_transform_faults(animation: Any, joints: Sequence[str]) -> Iterator[Fault]:
    """Yield a fault if an animation lacks translations, rotations or scales."""
    attributes = transform_attributes(animation)
    unauthored_names = [
        n for n, attr in attributes.items() if not attr.HasAuthoredValue()
    ]
    if len(unauthored_names) == len(attributes):
        message = f"lists {counted(len(joints), 'joint')} but has no transforms"
        hint = "author all three, or remove joints"
        prim_path = str(animation.GetPath())
        yield Fault(
            "USD150", message, None, (), hint, Severity.WARNING, where=prim_path
        )
    elif unauthored_names:
        message = f"no value for {listed(unauthored_names)}, but "
        message += counted(len(joints), "joint")
        yield finding("USD201", animation.GetPath(), message)


def non_finite_faults(
    attr: Any, matrices: FloatArray, joints: Sequence[str]
) -> Iterator[Fault]:
    """Yield a fault if joint transforms are not finite."""
    bad_joints = np.flatnonzero(~(np.abs(matrices) <= MAX_TRANSFORM).all(axis=(1, 2)))
    if len(bad_joints):
        names = [joints[i] for i in bad_joints.tolist()]
        message = f"{len(bad_joints)} transforms are not finite: {listed(names)}"
        yield finding("USD225", attr.GetPath(), message)
