"""Map files, ``*.map.yaml``: which target joints follow which source joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from annotated_types import Len
from pydantic import Field

from animtool.core.errors import counted
from animtool.core.names import name_hint
from animtool.core.options import key
from animtool.core.record import dataclass
from animtool.documents.check import FileModel, validate_file
from animtool.documents.document import Document, Location, read_document
from animtool.documents.fields import IgnoreModel, Name, Real
from animtool.retarget.map import TwistFraction
from animtool.retarget.names import strip_common_prefix
from animtool.retarget.roles import ROLES
from animtool.rig.sides import mirrored_name, name_side
from animtool.rig.skeleton import Rig

UnitReal = Annotated[Real, Field(ge=0, le=1)]
JointNames = Name | Annotated[list[Name], Len(1)]


class MapEntryModel(FileModel):
    """Joints of the target that follow joints of the source."""

    source: JointNames = key(
        "A joint of the take's skeleton, or several joints of a chain, root first.",
        "mixamorig:Spine",
    )
    target: JointNames = key(
        "The joint of the rig that follows it, or several. Chains of different "
        "numbers of joints are matched by normalised length.",
        ["spine_01", "spine_02"],
    )
    role: Name | None = key(
        "The role in the body. Default: found from names and structure.",
        "spine",
        default=None,
    )


class MapTwistModel(FileModel):
    """A joint of the target that takes a fraction of a bone's twist."""

    joint: Name = key("The joint that twists.", "upperarm_twist_01_l")
    bone: Name = key("The joint whose bone is twisted.", "upperarm_l")
    share: UnitReal = key("Fraction of the twist, from 0 to 1.", 0.5)


class MapIgnoredModel(FileModel):
    """Joints that are left at rest."""

    source: list[Name] = key(
        "Joints of the source to ignore.", ["HeadTop_End"], default=[]
    )
    target: list[Name] = key(
        "Joints of the target to ignore.", ["ik_foot_l"], default=[]
    )


class MapModel(FileModel):
    """A map file."""

    map: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    joints: Annotated[list[MapEntryModel], Len(1)] = key(
        "Which joints follow which.", [{"source": "Hips", "target": "pelvis"}]
    )
    others: Literal["none", "auto"] = key(
        "Joints that the file does not name: `none` keeps them at rest, `auto` maps "
        "them as without a file.",
        "auto",
        default="none",
    )
    twists: list[MapTwistModel] | None = key(
        "Joints that share a bone's twist. Default: those recognised by name.",
        [{"joint": "upperarm_twist_01_l", "bone": "upperarm_l", "share": 0.5}],
        default=None,
    )
    ignored: MapIgnoredModel = key(
        "Joints to keep at rest, whatever `others` states.",
        {"target": ["ik_foot_l"]},
        default=MapIgnoredModel(),
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "MAP002", "why": "this is intended"}],
        default=[],
    )


@dataclass(frozen=True, slots=True)
class MapFile:
    """A map file with its document, which locates faults in the text."""

    document: Document
    model: MapModel


class ResolvedEntry(NamedTuple):
    """Source and target joints of a map file's entry, as joint indices."""

    source: tuple[int, ...]
    target: tuple[int, ...]
    role: str  # empty if the file states none


@dataclass(frozen=True, slots=True)
class ResolvedMap:
    """A map file whose joint names are replaced by the joint indices of two rigs."""

    entries: tuple[ResolvedEntry, ...]
    twists: tuple[TwistFraction, ...] | None
    # Source joints and target joints that stay at rest.
    ignored_joints: tuple[frozenset[int], frozenset[int]]
    is_exclusive: bool  # whether joints that the file omits stay unmapped


def load_map(path: Path | str) -> MapFile:
    """Parse a map file; joint names are only checked by `resolve_map`.

    Raises:
        FormatError: The file cannot be read or is malformed; lists every fault.
    """
    return parse_map_document(read_document(Path(path), "map"))


def parse_map_document(document: Document) -> MapFile:
    """Return a document as a map file; raise on repeated targets or unknown roles."""
    model = validate_file(document, "map", MapModel)
    _check_distinct_targets(document, model)
    _check_distinct_twists(document, model)
    _check_ignored(document, model)
    for i, entry in enumerate(model.joints):
        if entry.role is not None and entry.role not in ROLES:
            message = f"unknown role {entry.role!r}"
            hint = name_hint(entry.role, ROLES)
            document.add("MAP005", ("joints", i, "role"), message, hint)
    document.check()
    return MapFile(document, model)


def _check_distinct_targets(document: Document, model: MapModel) -> None:
    """Record target joints that occur in two entries, or twice in one (MAP002)."""
    entry_of_joint: dict[str, int] = {}
    for i, entry in enumerate(model.joints):
        for name in dict.fromkeys(_name_list(entry.target)):
            j = entry_of_joint.setdefault(name, i)
            if j != i:
                _add_repeated_target(document, model, name, (j, i))
        names = _name_list(entry.target)
        for k, name in enumerate(names):
            if name in names[:k]:
                message = f"{name!r} appears twice in the list"
                location = ("joints", i, "target", k)
                document.add("MAP002", location, message, "remove one of them")


def _add_repeated_target(
    document: Document, model: MapModel, target_name: str, indices: tuple[int, int]
) -> None:
    """Record a repeated target, with the joint that was probably meant (MAP002)."""
    entries = [model.joints[i] for i in indices]
    sources = [", ".join(_name_list(entry.source)) for entry in entries]
    targets = {n for entry in model.joints for n in _name_list(entry.target)}
    message = f"{target_name!r} is the target of two entries"
    other_name = mirrored_name(target_name)
    is_wrong_side = [
        other_name not in targets and _entry_side(entry) == name_side(other_name or "")
        for entry in entries
    ]
    index, other_index = indices[::-1]
    if other_name is not None and sum(is_wrong_side) == 1:
        index, other_index = indices if is_wrong_side[0] else indices[::-1]
        message += f", and nothing follows {other_name!r}"
        hint = f"write {other_name} here, or remove one of the two entries"
    elif sources[0] == sources[1]:
        hint = "remove one of the two entries"
    else:
        hint = f"name the joint that follows {sources[1]!r} here, or remove one of them"
    other_line = document.position(("joints", other_index))[0]
    message += f" (the other is in line {other_line})"
    document.add("MAP002", ("joints", index, "target"), message, hint)


def _entry_side(entry: MapEntryModel) -> str:
    """Return the side that an entry's role states, else that of its source joints."""
    if entry.role in ROLES:
        return entry.role[-1] if entry.role[-2:] in {"_l", "_r"} else ""
    sides = {name_side(name) for name in _name_list(entry.source)}
    return sides.pop() if len(sides) == 1 else ""


def _check_distinct_twists(document: Document, model: MapModel) -> None:
    """Record joints that two twist entries name (MAP002)."""
    entry_of_joint: dict[str, int] = {}
    for i, twist in enumerate(model.twists or ()):
        j = entry_of_joint.setdefault(twist.joint, i)
        if j != i:
            message = f"{twist.joint!r} appears in two entries"
            hint = f"name another joint here, or remove this entry or twists[{j}]"
            document.add("MAP002", ("twists", i, "joint"), message, hint)


def _check_ignored(document: Document, model: MapModel) -> None:
    """Record joints that an entry uses although the file ignores them (MAP002)."""
    for side in ("source", "target"):
        entry_of_joint = {
            name: i
            for i, entry in enumerate(model.joints)
            for name in _name_list(getattr(entry, side))
        }
        for k, name in enumerate(getattr(model.ignored, side)):
            if name in entry_of_joint:
                entry_text = f"joints[{entry_of_joint[name]}]"
                message = f"{name!r} is a {side} of {entry_text} too"
                hint = f"remove it here to map it, or from {entry_text} to ignore it"
                document.add("MAP002", ("ignored", side, k), message, hint)


def resolve_map(file: MapFile, source: Rig, target: Rig) -> ResolvedMap:
    """Look up the joint names of a map file in two rigs (unknown: MAP001).

    A joint is matched by its name or by its name in the source file, with or without
    namespace and prefix.
    """
    document, model = file.document, file.model
    rigs = {"source": source, "target": target}
    joints_by_name = {side: _joints_by_name(rig) for side, rig in rigs.items()}
    _refuse_swapped_map(file, rigs, joints_by_name)

    prefixed_names: dict[str, list[tuple[str, Location]]] = {side: [] for side in rigs}

    def joint_indices(
        side: str, names: Sequence[str], *location: str | int
    ) -> tuple[int, ...]:
        """Return the indices of joints by name; record unknown ones."""
        for i, name in enumerate(names):
            if name not in joints_by_name[side]:
                if name.rpartition(":")[2] in joints_by_name[side]:
                    prefixed_names[side].append((name, (*location, i)))
                    continue
                message = f"the {side} {rigs[side].name!r} has no joint {name!r}"
                other_side = "target" if side == "source" else "source"
                hint = name_hint(name, joints_by_name[side])
                if name in joints_by_name[other_side]:
                    other_name = rigs[other_side].name
                    hint = f"the {other_side} {other_name!r} has this joint; swap "
                    hint += "source and target"
                document.add("MAP001", (*location, i), message, hint)
        return tuple(
            joints_by_name[side][n] for n in names if n in joints_by_name[side]
        )

    entries = [
        ResolvedEntry(
            joint_indices("source", _name_list(entry.source), "joints", i, "source"),
            joint_indices("target", _name_list(entry.target), "joints", i, "target"),
            entry.role or "",
        )
        for i, entry in enumerate(model.joints)
    ]
    twists: list[TwistFraction] = []
    for i, twist in enumerate(model.twists or ()):
        joints = joint_indices("target", [twist.joint], "twists", i, "joint")
        bones = joint_indices("target", [twist.bone], "twists", i, "bone")
        twists += [
            TwistFraction(*ends, twist.share)
            for ends in zip(joints, bones, strict=False)
        ]
    ignored = [
        frozenset(joint_indices(side, getattr(model.ignored, side), "ignored", side))
        for side in rigs
    ]
    for side, prefixed in prefixed_names.items():
        if prefixed:
            _add_prefix_fault(document, rigs[side], side, prefixed)
    _check_distinct_joints(document, entries, target)
    document.check()
    return ResolvedMap(
        tuple(entries),
        None if model.twists is None else tuple(twists),
        (ignored[0], ignored[1]),
        model.others == "none",
    )


def _add_prefix_fault(
    document: Document, rig: Rig, side: str, names: Sequence[tuple[str, Location]]
) -> None:
    """Record one fault for names with a namespace that their skeleton does not have."""
    (first, location), count = names[0], len(names)
    prefix, colon, bare_name = first.rpartition(":")
    message = f"the {side} {rig.name!r} has no joint {first!r}"
    message += f", nor {counted(count - 1, 'other name')} like it" if count > 1 else ""
    hint = f"leave out the namespace {prefix + colon!r}: write {bare_name!r}"
    fault = document.fault("MAP001", location, message, hint)
    lines = tuple(document.position(where)[0] for _, where in names)
    document.faults.append(replace(fault, lines=tuple(dict.fromkeys(lines))))


def _check_distinct_joints(
    document: Document, entries: Sequence[ResolvedEntry], target: Rig
) -> None:
    """Record target joints that two entries give different names (MAP002)."""
    entry_of_joint: dict[int, int] = {}
    for i, entry in enumerate(entries):
        for j in entry.target:
            other_index = entry_of_joint.setdefault(j, i)
            if other_index != i:
                message = (
                    f"joints[{other_index}] has the same joint {target.names[j]!r} of "
                )
                message += f"{target.name!r} by another name"
                hint = "remove one of the two entries"
                document.add("MAP002", ("joints", i, "target"), message, hint)


def _refuse_swapped_map(
    file: MapFile,
    rig_by_map_side: Mapping[str, Rig],
    joints_by_map_side: Mapping[str, Mapping[str, int]],
) -> None:
    """Raise a single fault if a map has source and target swapped (MAP001)."""
    document, entries = file.document, file.model.joints
    for side, other_side in (("source", "target"), ("target", "source")):
        names = [name for entry in entries for name in _name_list(getattr(entry, side))]
        if not all(
            n in joints_by_map_side[other_side] and n not in joints_by_map_side[side]
            for n in names
        ):
            return
    name = names[0]
    message = "source and target are swapped in this map: its targets, such as "
    message += f"{name!r}, are joints of the source {rig_by_map_side['source'].name!r}"
    hint = "swap the two names in each entry, or retarget in the other direction"
    document.add("MAP001", ("joints", 0), message, hint)
    document.check()


def _name_list(value: str | list[str]) -> list[str]:
    """Return a list of names, from a list or a single name."""
    return [value] if isinstance(value, str) else value


def _joints_by_name(rig: Rig) -> Mapping[str, int]:
    """Return a lookup of joint indices by every name that matches a joint."""
    joint_by_name: dict[str, int] = {}
    names_in_file = [joint.source_name or joint.name for joint in rig.joints]
    for names in (rig.names, names_in_file, strip_common_prefix(names_in_file)):
        for j, name in enumerate(names):
            joint_by_name.setdefault(name, j)
    return joint_by_name
