"""Warnings about joints of a map file that are out of the order of their skeleton."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from animtool.core.errors import Fault, Severity
from animtool.documents.document import Location
from animtool.retarget.file import MapFile, ResolvedEntry, ResolvedMap
from animtool.rig.skeleton import Rig

# Number of joints up to which a hint writes out a chain.
MAX_LISTED_CHAIN = 8


def map_order_warnings(
    file: MapFile, file_map: ResolvedMap, source: Rig, target: Rig
) -> Iterator[Fault]:
    """Yield warnings about chains listed upwards and exchanged entries (MAP112)."""
    entries = file_map.entries
    for i, entry in enumerate(entries):
        for side, chain, rig in (
            ("source", entry.source, source),
            ("target", entry.target, target),
        ):
            message_and_hint = _chain_order_texts(chain, rig)
            if message_and_hint:
                yield _order_warning(file, ("joints", i, side), *message_and_hint)
    for upper_entry, lower_entry in _exchanged_pairs(entries, source, target):
        upper_source, upper_target = _top_joints(entries[upper_entry], source, target)
        lower_source, lower_target = _top_joints(entries[lower_entry], source, target)
        message = f"{source.names[lower_source]!r} is below "
        message += f"{source.names[upper_source]!r}, but what follows it, "
        message += f"{target.names[lower_target]!r}, is above "
        message += f"{target.names[upper_target]!r}"
        i, k = sorted((upper_entry, lower_entry))
        hint = f"exchange the sources of joints[{i}] and joints[{k}]"
        yield _order_warning(file, ("joints", k, "source"), message, hint)


def _order_warning(file: MapFile, location: Location, message: str, hint: str) -> Fault:
    fault = file.document.fault("MAP112", location, message, hint)
    return replace(fault, severity=Severity.WARNING)


def _chain_order_texts(chain: Sequence[int], rig: Rig) -> tuple[str, str] | None:
    """Return message and hint for a joint listed after one below it, or None."""
    for k, joint in enumerate(chain):
        for lower_joint in chain[:k]:
            if not _is_above(rig, joint, lower_joint):
                continue
            name, lower_name = rig.names[joint], rig.names[lower_joint]
            message = f"{lower_name!r} is below {name!r} in {rig.name!r}, but is "
            message += "listed before it"
            order_text = f"{name} before {lower_name}"
            if len(chain) <= MAX_LISTED_CHAIN:
                ordered_chain = sorted(chain, key=lambda j: len(rig.upwards(j)))
                order_text = f"[{', '.join(rig.names[j] for j in ordered_chain)}]"
            return message, f"list a chain from its root: {order_text}"
    return None


def _exchanged_pairs(
    entries: Sequence[ResolvedEntry], source: Rig, target: Rig
) -> list[tuple[int, int]]:
    """Return entries of which the first is above the second only in the source.

    Each entry is in one pair: of several, those farthest apart are paired first.
    """
    top_joints = [_top_joints(entry, source, target) for entry in entries]
    entries_by_source: dict[int, list[int]] = {}
    for i, (source_top, _) in enumerate(top_joints):
        entries_by_source.setdefault(source_top, []).append(i)
    ancestors = [set(target.upwards(target_top)[1:]) for _, target_top in top_joints]
    candidates = [
        (-distance, upper, lower)
        for lower, (source_top, target_top) in enumerate(top_joints)
        for distance, joint in enumerate(source.upwards(source_top))
        if distance
        for upper in entries_by_source.get(joint, ())
        if target_top in ancestors[upper]
    ]
    pairs: list[tuple[int, int]] = []
    paired_entries: set[int] = set()
    for _, upper, lower in sorted(candidates):
        if paired_entries.isdisjoint((upper, lower)):
            paired_entries |= {upper, lower}
            pairs.append((upper, lower))
    return sorted(pairs, key=sorted)


def _top_joints(entry: ResolvedEntry, source: Rig, target: Rig) -> tuple[int, int]:
    return _top_joint(source, entry.source), _top_joint(target, entry.target)


def _top_joint(rig: Rig, chain: Sequence[int]) -> int:
    """Return the joint of a chain that is nearest to the root."""
    return min(chain, key=lambda j: len(rig.upwards(j)))


def _is_above(rig: Rig, joint: int, other_joint: int) -> bool:
    """Return whether a joint is an ancestor of another one."""
    return joint in rig.upwards(other_joint)[1:]
