"""The map from source joints to target joints, and its text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from animtool.core.errors import Fault
from animtool.core.names import decimal_text, yaml_scalar
from animtool.core.record import dataclass
from animtool.retarget.roles import Anatomy, RoleSource
from animtool.rig.skeleton import Rig

# Columns of a map file's lists.
LINE_WIDTH = 88


@dataclass(frozen=True, slots=True)
class JointPair:
    """A source joint and the target joint that follows it."""

    source: int  # index of the joint
    target: int  # index of the joint
    role: str  # one of `ROLES`; empty if only a file or a name pairs them
    evidence: RoleSource  # the weaker evidence of the two
    confidence: float  # 0 to 1


@dataclass(frozen=True, slots=True)
class JointChain:
    """Joints of one role on both sides, where either side has several.

    A joint's position on the chain is its distance from the start over the chain's
    length, including the last bone: 0 for the first joint.
    """

    role: str
    source: tuple[int, ...]
    target: tuple[int, ...]
    # Positions of the joints along the chain, from 0 to below 1.
    source_fractions: tuple[float, ...]
    target_fractions: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class TwistFraction:
    """A target joint that takes a fraction of a bone's twist."""

    target: int  # index in the target
    bone: int  # index in the target of the joint whose bone is twisted
    fraction: float  # fraction of the bone's twist, 0 at its start to 1 at its end


@dataclass(frozen=True, slots=True)
class JointMap:
    """The pairs, chains and twists by which target joints follow source joints."""

    pairs: tuple[JointPair, ...]  # in the order of the target's joints
    chains: tuple[JointChain, ...]
    twists: tuple[TwistFraction, ...]
    unmapped_source: tuple[int, ...]  # joints that no target joint follows
    unmapped_target: tuple[int, ...]  # joints that stay at rest
    source: Anatomy
    target: Anatomy
    notices: tuple[Fault, ...] = ()


def map_text(joint_map: JointMap, source: Rig, target: Rig) -> str:
    """Format a joint map as the text of a map file that users can edit.

    Loading the text for the same skeletons gives the same pairs, chains and twists.
    """
    return "\n".join(_map_lines(joint_map, source, target)) + "\n"


def _map_lines(joint_map: JointMap, source: Rig, target: Rig) -> Iterator[str]:
    """Yield the lines of a map file; joints mapped with doubt get a comment."""
    source_names, target_names = source.names, target.names
    yield f"# {yaml_scalar(source.name)} onto {yaml_scalar(target.name)}"
    yield "map: animtool/1"
    # Written so that users see the key and its values.
    yield "others: none  # auto maps joints that are not named here, as without a file"
    yield "joints:"
    chain_joints = {j for chain in joint_map.chains for j in chain.target}
    chain_by_first_target = {chain.target[0]: chain for chain in joint_map.chains}
    for pair in joint_map.pairs:
        if pair.target in chain_by_first_target:
            chain = chain_by_first_target[pair.target]
            source_text = _flow_list([source_names[j] for j in chain.source])
            target_text = _flow_list([target_names[j] for j in chain.target])
        elif pair.target in chain_joints:
            continue
        else:
            source_text = yaml_scalar(source_names[pair.source])
            target_text = yaml_scalar(target_names[pair.target])
        role = f", role: {pair.role}" if pair.role else ""
        confidence_note = f"  # {pair.evidence or 'unsure'}, {pair.confidence:.0%} sure"
        comment = confidence_note if pair.confidence < 1.0 else ""
        yield f"- {{source: {source_text}, target: {target_text}{role}}}{comment}"
    if joint_map.twists:
        yield "twists:"
    for twist in joint_map.twists:
        joint = yaml_scalar(target_names[twist.target])
        bone = yaml_scalar(target_names[twist.bone])
        fraction = decimal_text(round(twist.fraction, 6))
        yield f"- {{joint: {joint}, bone: {bone}, share: {fraction}}}"
    unmapped_names = {
        "source": [source_names[j] for j in joint_map.unmapped_source],
        "target": [target_names[j] for j in joint_map.unmapped_target],
    }
    if any(unmapped_names.values()):
        yield "ignored:"
    for side, names in unmapped_names.items():
        if names:
            yield from _wrapped_lines(f"  {side}: [", list(map(yaml_scalar, names)))


def _wrapped_lines(prefix: str, names: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a YAML list of names, wrapped at the line width."""
    line = prefix
    for i, name in enumerate(names):
        is_last = i == len(names) - 1
        name_text = f"{name}]" if is_last else f"{name},"
        separator = "" if line == prefix or line.endswith(" ") else " "
        if len(line) + len(separator) + len(name_text) > LINE_WIDTH and line != prefix:
            yield line
            line, separator = " " * len(prefix), ""
        line += f"{separator}{name_text}"
    yield line


def _flow_list(names: Sequence[str]) -> str:
    """Return names as a YAML flow list; a single name without brackets."""
    if len(names) == 1:
        return yaml_scalar(names[0])
    return f"[{', '.join(map(yaml_scalar, names))}]"
