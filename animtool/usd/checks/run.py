"""All checks on one layer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from pxr import Usd

from animtool.errors import Fault, FormatError
from animtool.usd.checks.animation import check_animations, check_known_joints
from animtool.usd.checks.bindings import check_bindings
from animtool.usd.checks.composition import check_assets, check_composition
from animtool.usd.checks.extents import check_extents
from animtool.usd.checks.physics import check_physics
from animtool.usd.checks.points import check_points
from animtool.usd.checks.shapes import check_shapes, check_targets
from animtool.usd.checks.skeleton import check_skeletons
from animtool.usd.checks.skin import check_skins
from animtool.usd.checks.splines import check_splines, check_uniform
from animtool.usd.checks.stage_metadata import (
    check_range,
    check_rate_values,
    check_rates,
    check_units,
)
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.types import check_types
from animtool.usd.checks.usd_validators import check_with_usd
from animtool.usd.checks.value_clips import check_value_clips
from animtool.usd.layers import find_layer, usd_errors
from animtool.usd.stderr import without_usd_warnings

__all__ = ["check_layer", "check_stage"]

Check: TypeAlias = Callable[[Subject], Iterator[Fault]]

# These ask for no sample; the others need rates that are such.
UNTIMED: tuple[Check, ...] = (check_rate_values, check_composition, check_units)
TIMED: tuple[Check, ...] = (
    check_assets,
    check_rates,
    check_range,
    check_bindings,
    check_skeletons,
    check_animations,
    check_known_joints,
    check_skins,
    check_targets,
    check_shapes,
    check_points,
    check_extents,
    check_physics,
    check_splines,
    check_uniform,
    check_value_clips,
)


def check_layer(path: Path | str) -> list[Fault]:
    """Return all that is wrong with a USD layer and what it brings in.

    What cannot be opened has that as its one finding. USD's own warnings about the
    layer are not printed meanwhile: the findings say the same.

    Args:
        path: A USD file of any kind.
    """
    path = Path(path)
    try:
        with without_usd_warnings(), usd_errors(path):
            stage = Usd.Stage.Open(find_layer(path))
            found = [*check_stage(stage), *_run(check_with_usd, Subject(stage))]
    except FormatError as error:
        return list(error.faults)
    return [replace(fault, path=str(path)) for fault in _distinct(found)]


def check_stage(stage: Any) -> list[Fault]:
    """Return what our own checks find on a stage.

    Args:
        stage: A `Usd.Stage`.
    """
    subject = Subject(stage)
    found = [fault for check in UNTIMED for fault in _run(check, subject)]
    if not any(fault.code == "USD253" for fault in found):
        found += [fault for check in TIMED for fault in _run(check, subject)]
    return _distinct(found)


def _run(check: Check, subject: Subject) -> Iterator[Fault]:
    """Yield what a check finds; what USD itself refuses meanwhile is a finding too.

    Where a value is of another type than its schema wants, a check ends there.
    """
    try:
        with usd_errors(Path(subject.stage.GetRootLayer().identifier)):
            yield from check(subject)
    except FormatError as error:
        yield from (replace(fault, where="/") for fault in error.faults)
    except (AttributeError, IndexError, TypeError, ValueError):
        mistyped = list(check_types(subject))
        if not mistyped:
            raise
        yield from mistyped


def _distinct(faults: list[Fault]) -> list[Fault]:
    """Return faults without those that one before says of the same place.

    Of a code and a place, the first message counts: a validator of USD may find
    what ours did.
    """
    seen: dict[tuple[str, str | None], bool] = {}
    kept = []
    for fault in faults:
        foreign = fault.message.partition(":")[0].lower().startswith("usd")
        key = (fault.code, fault.where)
        if foreign and key in seen and not seen[key]:
            continue
        seen.setdefault(key, foreign)
        kept.append(fault)
    return kept
