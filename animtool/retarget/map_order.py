"""Warnings about joints of a map file that are out of the order of their skeleton."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

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
            texts = _chain_order_texts(chain, rig)
            if texts:
                yield _order_warning(file, ("joints", i, side), *texts)
    for i, k in combinations(range(len(entries)), 2):
        texts = _exchanged_texts((i, k), entries[i], entries[k], source, target)
        if texts:
            yield _order_warning(file, ("joints", k, "source"), *texts)


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


def _exchanged_texts(
    indices: tuple[int, int],
    entry: ResolvedEntry,
    other_entry: ResolvedEntry,
    source: Rig,
    target: Rig,
) -> tuple[str, str] | None:
    """Return message and hint for entries with opposite hierarchies, or None."""
    joints = [
        [_top_joint(rig, chain) for chain in chains]
        for rig, chains in (
            (source, (entry.source, other_entry.source)),
            (target, (entry.target, other_entry.target)),
        )
    ]
    upper = 0 if _is_above(source, *joints[0]) else 1
    lower = 1 - upper
    if not (
        _is_above(source, joints[0][upper], joints[0][lower])
        and _is_above(target, joints[1][lower], joints[1][upper])
    ):
        return None
    names = [source.names[j] for j in joints[0]], [target.names[j] for j in joints[1]]
    message = f"{names[0][lower]!r} is below {names[0][upper]!r}, but what follows it, "
    message += f"{names[1][lower]!r}, is above {names[1][upper]!r}"
    return message, "exchange the sources of joints[{}] and joints[{}]".format(*indices)


def _top_joint(rig: Rig, chain: Sequence[int]) -> int:
    """Return the joint of a chain that is nearest to the root."""
    return min(chain, key=lambda j: len(rig.upwards(j)))


def _is_above(rig: Rig, joint: int, other_joint: int) -> bool:
    """Return whether a joint is an ancestor of another one."""
    return joint in rig.upwards(other_joint)[1:]
