"""The map from source joints to target joints, and its text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from animtool.core.errors import Fault
from animtool.core.names import number, text
from animtool.core.record import dataclass
from animtool.retarget.roles import Anatomy, RoleSource
from animtool.rig.skeleton import Rig

# Columns of a map file's lists.
WIDTH = 88


@dataclass(frozen=True, slots=True)
class JointPair:
    """A source joint and the target joint that follows it."""

    source: int  # index of the joint
    target: int  # index of the joint
    role: str  # of `ROLES`; empty if a file or a name alone pairs them
    evidence: RoleSource  # the weaker of the two
    confidence: float  # 0 to 1


@dataclass(frozen=True, slots=True)
class JointChain:
    """Joints of one role on both sides, where either side has several.

    The start of a joint is its distance along the chain over the length of the chain
    with its last bone: 0 for the first.
    """

    role: str
    source: tuple[int, ...]
    target: tuple[int, ...]
    source_at: tuple[float, ...]  # 0 to 1, below 1
    target_at: tuple[float, ...]  # 0 to 1, below 1


@dataclass(frozen=True, slots=True)
class TwistFraction:
    """A target joint that takes a fraction of a bone's twist."""

    target: int  # index in the target
    bone: int  # index in the target of the joint whose bone is twisted
    fraction: float  # of the twist from the bone's begin (0) to its end (1)


@dataclass(frozen=True, slots=True)
class JointMap:
    """Which target joints follow which source joints."""

    pairs: tuple[JointPair, ...]  # in the order of the target's joints
    chains: tuple[JointChain, ...]
    twists: tuple[TwistFraction, ...]
    unmapped_source: tuple[int, ...]  # joints that move nothing
    unmapped_target: tuple[int, ...]  # joints that stay at rest
    source: Anatomy
    target: Anatomy
    notices: tuple[Fault, ...] = ()

    def by_role(self, role: str) -> JointPair | None:
        """Return the first pair of a role; None if it is not mapped."""
        return next((pair for pair in self.pairs if pair.role == role), None)


def map_text(joint_map: JointMap, source: Rig, target: Rig) -> str:
    """Return a map as the text of a map file that users can edit.

    Loaded for the same skeletons, it gives the same pairs, chains and twists.
    """
    return "\n".join(_lines(joint_map, source, target)) + "\n"


def _lines(joint_map: JointMap, source: Rig, target: Rig) -> Iterator[str]:
    source_names, target_names = source.names, target.names
    yield f"# {text(source.name)} onto {text(target.name)}"
    yield "map: animtool/1"
    # Shown so that users find the key and its values.
    yield "others: none  # auto maps joints that are not named here, as without a file"
    yield "joints:"
    chained = {j for chain in joint_map.chains for j in chain.target}
    chains = {chain.target[0]: chain for chain in joint_map.chains}
    for pair in joint_map.pairs:
        if pair.target in chains:
            chain = chains[pair.target]
            left = _flow([source_names[j] for j in chain.source])
            right = _flow([target_names[j] for j in chain.target])
        elif pair.target in chained:
            continue
        else:
            left, right = (
                text(source_names[pair.source]),
                text(target_names[pair.target]),
            )
        role = f", role: {pair.role}" if pair.role else ""
        sure = f"  # {pair.evidence or 'unsure'}, {pair.confidence:.0%} sure"
        comment = sure if pair.confidence < 1.0 else ""
        yield f"- {{source: {left}, target: {right}{role}}}{comment}"
    if joint_map.twists:
        yield "twists:"
    for twist in joint_map.twists:
        joint, bone = text(target_names[twist.target]), text(target_names[twist.bone])
        fraction = number(round(twist.fraction, 6))
        yield f"- {{joint: {joint}, bone: {bone}, share: {fraction}}}"
    unmapped = {
        "source": [source_names[j] for j in joint_map.unmapped_source],
        "target": [target_names[j] for j in joint_map.unmapped_target],
    }
    if any(unmapped.values()):
        yield "ignored:"
    for side, names in unmapped.items():
        if names:
            yield from _wrapped(f"  {side}: [", list(map(text, names)))


def _wrapped(head: str, names: Sequence[str]) -> Iterator[str]:
    """Yield the wrapped lines of a list of names."""
    line = head
    for i, name in enumerate(names):
        last = i == len(names) - 1
        item = f"{name}]" if last else f"{name},"
        gap = "" if line == head or line.endswith(" ") else " "
        if len(line) + len(gap) + len(item) > WIDTH and line != head:
            yield line
            line, gap = " " * len(head), ""
        line += f"{gap}{item}"
    yield line


def _flow(names: Sequence[str]) -> str:
    if len(names) == 1:
        return text(names[0])
    return f"[{', '.join(map(text, names))}]"
