"""Reading a targets file, ``*.targets.yaml``."""

from __future__ import annotations

import math
from collections.abc import Set as AbstractSet
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np

from animtool.clip.channels import ClipUnits
from animtool.clip.file import read_range
from animtool.clip.schema import CurveModel
from animtool.core.config import project_roots
from animtool.core.errors import listed
from animtool.core.names import belong_elsewhere, most_similar
from animtool.core.rates import RateError, parse_rate
from animtool.core.units import LengthUnit
from animtool.documents.arrays import Archives
from animtool.documents.check import validate_file
from animtool.documents.document import Document, Location, read_document
from animtool.documents.fields import MAX_FRAME
from animtool.ik.goals import GOAL_KINDS, GOAL_PARTS, Goal, GoalKind, root_problem
from animtool.ik.schema import GoalModel, TargetsModel, WeightsModel
from animtool.ik.suspicions import (
    warn_of_angles,
    warn_of_offsets,
    warn_of_quaternion_order,
    warn_of_seconds,
    warn_of_stretch,
)
from animtool.ik.tracks import DEFAULT_RATE, GoalTrack, TargetTracks
from animtool.ik.values import ConstantValue, SampledValue, ValueReader
from animtool.rig.parts import IkChain, Vector
from animtool.rig.skeleton import Rig

# Number of unknown effectors from which targets may be for another rig.
MIN_UNKNOWN_EFFECTORS = 2
# A shorter direction is a typing error and is refused.
MIN_DIRECTION = 1e-9


def load_targets(path: Path | str, rig: Rig | None = None) -> TargetTracks:
    """Read a targets file for a rig.

    Args:
        path: The file.
        rig: Rig with the joints and chains of the effectors; None checks everything
            else, in metres, and takes every name for a joint.

    Raises:
        FormatError: The file is faulty; lists every fault with line and column.
        OptionError: The project's settings are malformed.
    """
    return targets_of_document(read_document(Path(path), "targets"), rig)


def targets_of_document(document: Document, rig: Rig | None) -> TargetTracks:
    """Return the target tracks of a document; see `load_targets`."""
    model = validate_file(document, "targets", TargetsModel)
    with Archives() as archives:
        tracks = _TargetsReader(document, model, rig, archives).read_tracks()
    document.check()
    return tracks


class _TargetsReader:
    """Reads the goals of a validated targets document."""

    def __init__(
        self,
        document: Document,
        model: TargetsModel,
        rig: Rig | None,
        archives: Archives,
    ) -> None:
        self.document, self.model, self.rig = document, model, rig
        self.first, self.last = self._read_range()
        row_count = None
        if self.first is not None and self.last is not None and self.first <= self.last:
            row_count = int((self.last - self.first) // 1) + 1
        units = self._read_units()
        roots = project_roots(document.path)
        first = self.first
        self.value_reader = ValueReader(
            document, rig, units, roots, archives, first, row_count
        )

    def read_tracks(self) -> TargetTracks:
        """Return the tracks of the file; record its faults."""
        fps = self._read_rate()
        warn_of_quaternion_order(self.document)
        goals = [
            track
            for i, goal in enumerate(self.model.goals)
            if (track := self._read_goal(("goals", i), goal)) is not None
        ]
        frames = None
        if self.first is not None and self.last is not None:
            frames = float(self.first), float(self.last)
        self._merge_unknown_effectors()
        warn_of_seconds(self.document, fps or DEFAULT_RATE, frames, goals)
        units, rig = self.value_reader.units, self.rig
        warn_of_angles(self.document, goals, units, rig)
        warn_of_stretch(self.document, self.model.goals)
        if rig is not None:
            warn_of_offsets(self.document, self.model.goals, units, rig)
        return TargetTracks(
            self.document.path,
            fps,
            self.first,
            self.last,
            tuple(goals),
            tuple(self.document.notices),
            self.document.position(("fps",)),
        )

    def _merge_unknown_effectors(self) -> None:
        """Merge faults of unknown effectors if the targets are for another rig."""
        faults, goal_count = self.document.faults, len(self.model.goals)
        effector_faults = [
            fault
            for fault in faults
            if fault.code == "TGT001" and (fault.where or "").endswith(".effector")
        ]
        if self.rig is None or not effector_faults:
            return
        chain_names = [chain.name for chain in self.rig.chains]
        known_names = [*chain_names, *self.rig.names]
        effectors = (goal.effector for goal in self.model.goals)
        unknown_names = [name for name in effectors if name not in known_names]
        are_similar = [bool(most_similar(name, known_names)) for name in unknown_names]
        is_only_goal = goal_count == 1
        if not is_only_goal and not belong_elsewhere(
            are_similar, goal_count, MIN_UNKNOWN_EFFECTORS
        ):
            return
        if is_only_goal and chain_names:
            # It may be a typing error, or a goal of another rig.
            fault = effector_faults[0]
            hint = (fault.hint or "").removesuffix("?")
            hint += ", or are these the targets of another rig? the chains of "
            hint += f"{self.rig.name!r} are {listed(list(map(repr, chain_names)), 8)}"
            faults[faults.index(fault)] = replace(fault, hint=hint.lstrip(", "))
        if is_only_goal:
            return
        quoted_names = list(dict.fromkeys(map(repr, unknown_names)))
        message = (
            f"{len(unknown_names)} of {goal_count} effectors are not in "
            f"{self.rig.name!r}: {listed(quoted_names, 4)}; these targets look like "
            "those of another rig"
        )
        hint = f"{self.rig.name!r} has no chains"
        if chain_names:
            hint = f"the chains of {self.rig.name!r} are {listed(chain_names, 8)}"
        hint += "; pass the rig that the targets are for"
        merged_fault = replace(effector_faults[0], message=message, hint=hint)
        other_faults = [fault for fault in faults if fault not in effector_faults]
        faults[:] = [merged_fault, *other_faults]

    def _read_units(self) -> ClipUnits:
        """Return the units of the file, by default those of its rig."""
        rig, units = self.rig, self.model.units
        length = 1.0 if rig is None else rig.meters_per_unit
        angle = math.radians(1.0) if rig is None else rig.radians_per_unit
        if units.length is not None:
            length = LengthUnit(units.length).meters
        if units.angle is not None:
            angle = math.radians(1.0) if units.angle == "deg" else 1.0
        return ClipUnits(length, angle)

    def _read_rate(self) -> Fraction | None:
        """Return the frame rate; None if the file has none."""
        if self.model.fps is None:
            return None
        try:
            return parse_rate(self.model.fps)
        except RateError as error:
            self.document.add(error.code, ("fps",), str(error))
            return None

    def _read_range(self) -> tuple[Fraction | None, Fraction | None]:
        """Return first and last frame; None if the file has no range."""
        if self.model.range is None or self.document.is_placeholder(("range",)):
            return None, None
        first, last = self.model.range
        return read_range(self.document, first, last)

    def _read_goal(self, location: Location, model: GoalModel) -> GoalTrack | None:
        """Return the track of a goal; None if it is faulty."""
        joint, chain = self._read_effector((*location, "effector"), model.effector)
        root = self._read_root(location, model, joint, chain)
        hold_spans = self._read_spans((*location, "hold"), model.hold)
        active_spans = self._read_spans((*location, "during"), model.during)
        value_by_part = {
            kind.name: self._read_value(location, model, kind) for kind in GOAL_KINDS
        }
        parts_to_hold = (
            _hold_parts(value_by_part, chain) if hold_spans else frozenset[str]()
        )
        value_parts = {
            goal_part
            for goal_part in GOAL_PARTS
            if getattr(model, goal_part) is not None
        }
        is_empty = not value_parts - {"pole"} and not model.hold
        if is_empty and not self.document.has_placeholder_below(location):
            message = f"has no goal for {model.effector!r}"
            hint = "add a position, an orientation, an aim or spans to hold"
            self.document.add("TGT002", location, message, hint)
        used_parts = value_parts | parts_to_hold
        weights = self._read_weights((*location, "weight"), model.weight, used_parts)
        aim_axes = [
            self._read_axis((*location, kind.name, "axis"), goal_part.axis)
            for kind in GOAL_KINDS
            if kind.has_axis and (goal_part := getattr(model, kind.name)) is not None
        ]
        if joint is None:
            return None
        x, y, z = (value * self.value_reader.units.length for value in model.offset)
        stretch = 0.0 if chain is None else chain.stretch
        goal = Goal(
            joint,
            (x, y, z),
            aim_axis=aim_axes[0] if aim_axes else (0.0, 0.0, 1.0),
            root=root,
            priority=model.priority,
            soft=model.soft,
            stretch=stretch if model.stretch is None else model.stretch,
            **{goal_part: float(goal_part in used_parts) for goal_part in GOAL_PARTS},
        )
        return GoalTrack(
            model.effector,
            goal,
            chain,
            value_by_part,
            weights,
            tuple(hold_spans),
            model.ease,
            frozenset(parts_to_hold),
            location=self.document.position(location),
            during=tuple(active_spans),
        )

    def _read_value(
        self, location: Location, model: GoalModel, kind: GoalKind
    ) -> SampledValue | None:
        """Return the value of a part of a goal; None if absent."""
        key = kind.name
        location = (*location, key)
        value = getattr(model, key)
        if kind.has_axis and value is not None:
            location, value, key = (*location, "at"), value.at, "at"
        return self.value_reader.read_value(location, value, key)

    def _read_effector(
        self, location: Location, effector_name: str
    ) -> tuple[str | None, IkChain | None]:
        """Return the joint of an effector, and the chain whose tip it is."""
        if self.rig is None:
            return effector_name, None
        for chain in self.rig.chains:
            if chain.name == effector_name:
                return chain.tip, chain
        if effector_name in self.rig.names:
            return effector_name, None
        if not self.document.is_placeholder(location):
            chain_names = [chain.name for chain in self.rig.chains]
            message = (
                f"{effector_name!r} is neither a chain nor a joint of {self.rig.name!r}"
            )
            self.document.add(
                "TGT001",
                location,
                message,
                self.rig.joint_hint(effector_name, chain_names),
            )
        return None, None

    def _read_root(
        self,
        goal_location: Location,
        model: GoalModel,
        joint_name: str | None,
        chain: IkChain | None,
    ) -> str | None:
        """Return the root of a goal from the file, else the root of its chain."""
        root_name = model.root
        if root_name is None:
            return None if chain is None else chain.root
        if self.rig is None or joint_name is None:
            return root_name
        location = (*goal_location, "root")
        if root_name not in self.rig.names:
            message = f"unknown joint {root_name!r} of {self.rig.name!r}"
            hint = self.rig.joint_hint(root_name)
            self.document.add("TGT001", location, message, hint)
            return None
        if self.rig.index(root_name) not in self.rig.upwards(
            self.rig.index(joint_name)
        ):
            form = "write effector: {joint}, root: {root}"
            message, hint = root_problem(self.rig, root_name, joint_name, form)
            self.document.add("TGT012", location, message, hint)
        return root_name

    def _read_spans(
        self, location: Location, spans_in_file: list[list[float]]
    ) -> list[tuple[float, float]]:
        """Return spans in ascending order; record reversed or overlapping spans."""
        spans: list[tuple[float, float, int]] = []
        for i, span in enumerate(spans_in_file):
            if self.document.is_placeholder((*location, i)):
                continue
            first, last = span
            if first > last:
                message = f"the span from {first:g} to {last:g} is reversed"
                hint = f"write [{last:g}, {first:g}]"
                self.document.add("TGT005", (*location, i), message, hint)
                continue
            if max(abs(first), abs(last)) > MAX_FRAME:
                message = f"a frame is beyond {MAX_FRAME:.0e}"
                self.document.add("TGT005", (*location, i), message)
                continue
            spans.append((first, last, i))
        spans.sort()
        for (first, last, _), (next_first, end, i) in pairwise(spans):
            if next_first <= last:
                message = f"the span from {next_first:g} to {end:g} overlaps that from "
                message += f"{first:g} to {last:g}"
                self.document.add("TGT005", (*location, i), message, "merge them")
        return [(first, last) for first, last, _ in spans]

    def _read_axis(self, location: Location, axis: list[float]) -> Vector:
        """Normalize a direction; record a fault if it has zero length."""
        length = math.hypot(*axis)
        if not length > MIN_DIRECTION:
            message = f"direction {axis} has zero length"
            hint = "write the direction to aim, such as [0, 0, 1]"
            self.document.add("TGT008", location, message, hint)
            return (0.0, 0.0, 1.0)
        x, y, z = (value / length for value in axis)
        return (x, y, z)

    def _read_weights(
        self,
        location: Location,
        model: float | WeightsModel,
        used_parts: AbstractSet[str],
    ) -> dict[str, SampledValue]:
        """Return the weights of the parts; constant weights of 1 are left out."""
        if not isinstance(model, WeightsModel):
            if model == 0 and not self.document.is_placeholder(location):
                message = "a weight of 0 has no effect"
                self.document.add("TGT002", location, message, "remove the goal")
            if model == 1:
                return {}
            return {part: ConstantValue((float(model),)) for part in GOAL_PARTS}
        weight_by_part: dict[str, SampledValue] = {}
        for part in GOAL_PARTS:
            weight = getattr(model, part)
            if weight is None:
                continue
            if part not in used_parts:
                message = f"the weight of the {part} has no effect: the goal has none"
                self.document.warn("TGT101", (*location, part), message)
            curve = self._read_weight((*location, part), weight)
            if curve is not None:
                weight_by_part[part] = curve
        return weight_by_part

    def _read_weight(
        self, location: Location, model: float | CurveModel
    ) -> SampledValue | None:
        """Return a weight or weight curve, or None after recording a fault."""
        if not isinstance(model, CurveModel):
            return ConstantValue((float(model),))
        curve = self.value_reader.read_curve(location, model, "weight")
        if curve is not None and (curve.channel.values < 0).any():
            k = int(np.argmax(curve.channel.values[:, 0] < 0))
            message = f"weight {curve.channel.values[k, 0]:g} is less than 0"
            self.document.add("TGT007", (*location, "keys", k, "v"), message)
        return curve


def _hold_parts(
    value_by_part: dict[str, SampledValue | None], chain: IkChain | None
) -> frozenset[str]:
    """Return the parts that `hold` spans keep: those with targets, else the chain's."""
    pose_parts = ("position", "orientation")
    parts_with_value = frozenset(p for p in pose_parts if value_by_part[p] is not None)
    chain_goal = "pose" if chain is None else chain.goal
    goal_parts = frozenset(part for part in pose_parts if chain_goal in {part, "pose"})
    return parts_with_value or goal_parts
