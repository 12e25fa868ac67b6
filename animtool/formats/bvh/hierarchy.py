"""Parses the header of a BVH file: the HIERARCHY block, frame count and frame time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import field
from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.errors import Fault, Severity, counted, excerpt, listed
from animtool.core.names import most_similar
from animtool.core.quantities import CONTROL_CHARACTERS
from animtool.core.rates import (
    RateChoice,
    RateKind,
    rate_from_frame_time,
    rate_label,
    rate_of_milliseconds,
)
from animtool.core.record import dataclass
from animtool.formats import FLOAT32_MAX
from animtool.formats.bvh.lines import HeaderLines
from animtool.rig.skeleton import CHANNEL_NAMES

_KEYWORDS = ("ROOT", "JOINT", "End Site", "OFFSET", "CHANNELS", "MOTION")
_CHANNELS = {name.lower(): name for name in CHANNEL_NAMES}

# Range of plausible rates, from stop motion on sixes to the fastest capture systems.
# Outside it, a rate may have been written as a time, or milliseconds as seconds.
PLAUSIBLE_RATES = (4, 1000)

_WORDS_AFTER_OFFSET = {"{", "}", "CHANNELS", "JOINT", "END"}

_TRUNCATED_HINT = "is it truncated? copy or export it again"
_CONTROL_PATTERN = re.compile(f"[{CONTROL_CHARACTERS}]")
_WORD_PATTERN = re.compile(r"[{}]|[^\s{}]+")


@dataclass(slots=True)
class BvhJoint:
    """A joint of the HIERARCHY, with lengths in the file's unit."""

    name: str
    parent: int
    line: int
    offset: tuple[float, float, float] | None = None
    channels: tuple[str, ...] | None = None
    tips: list[tuple[float, float, float]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class BvhHeader:
    """Hierarchy, frame count and frame time of a BVH file."""

    joints: list[BvhJoint]  # in file order, parents first
    declared_frame_count: int  # value of ``Frames:``
    frames_line: int  # 1-based line of ``Frames:``
    frame_time: str  # text of ``Frame Time:``
    rate_choice: RateChoice  # frame rate chosen for the frame time


@dataclass(slots=True)
class _OpenBlock:
    """A block that is not closed yet: of a joint, or of the End Site of a joint."""

    joint_index: int  # index of the joint, or of the End Site's parent
    is_end_site: bool
    line: int
    has_brace: bool = False  # whether the opening brace was read
    has_offset: bool = False


class _HierarchyParser:
    """Parses the statements of a HIERARCHY block one by one."""

    def __init__(self, lines: HeaderLines) -> None:
        self.lines = lines
        self.joints: list[BvhJoint] = []
        self.open_blocks: list[_OpenBlock] = []

    def parse(self) -> None:
        """Parse the block up to and including the line MOTION."""
        line: str | None = self._read_start()
        while line is not None:
            words = _WORD_PATTERN.findall(line)
            while words:
                keyword = words.pop(0)
                if keyword.upper() == "MOTION" and not words:
                    self._check_complete()
                    return
                self._parse_statement(keyword, words)
            line = self.lines.next_line()
        message = "the file ends inside the HIERARCHY, without a MOTION block"
        hint = self._missing_braces_hint() or _TRUNCATED_HINT
        self.lines.fail("BVH005", message, hint)

    def _read_start(self) -> str:
        """Read the line HIERARCHY; return the text after that word."""
        while (line := self.lines.next_line()) is not None and not line.strip():
            continue
        keyword, _, remaining_text = (line or "").strip().partition(" ")
        if keyword.upper() != "HIERARCHY":
            start_text = f", not {excerpt(line.strip())}" if line else ""
            self.lines.fail("BVH001", f"a BVH file starts with HIERARCHY{start_text}")
        return remaining_text

    def _parse_statement(self, keyword: str, words: list[str]) -> None:
        statement = keyword.upper()
        block = self.open_blocks[-1] if self.open_blocks else None
        if block is not None and not block.has_brace and statement != "{":
            message = f"'{{' is missing before {excerpt(keyword)}"
            self.lines.fail("BVH004", message, self._block_label(block))
        match statement:
            case "{":
                self._open_block(block)
            case "}":
                self._close_block()
            case "ROOT" | "JOINT":
                self._parse_joint(statement, words, block)
            case "END":
                self._parse_end_site(words, block)
            case "OFFSET":
                self._parse_offset(words, block)
            case "CHANNELS":
                self._parse_channels(words, block)
            case _:
                similar_keyword = most_similar(keyword.upper(), _KEYWORDS)
                hint = f"expected {', '.join(_KEYWORDS)}, {{ or }}"
                hint = f"did you mean {similar_keyword}?" if similar_keyword else hint
                self.lines.fail("BVH003", f"unexpected {excerpt(keyword)}", hint)

    def _open_block(self, block: _OpenBlock | None) -> None:
        if block is None or block.has_brace:
            self.lines.fail("BVH004", "'{' without a joint")
        block.has_brace = True

    def _close_block(self) -> None:
        if not self.open_blocks:
            message = "'}' without a matching '{'"
            self.lines.fail("BVH004", message, "there is one brace too many")
        block = self.open_blocks.pop()
        if not block.is_end_site and not block.has_offset:
            self.lines.fail("BVH006", f"{self._block_label(block)} has no OFFSET")

    def _parse_joint(
        self, keyword: str, words: list[str], block: _OpenBlock | None
    ) -> None:
        if (keyword == "ROOT") != (block is None):
            context = "inside a joint" if block else "outside every joint"
            hint = f"expected {'JOINT' if block else 'ROOT'}"
            self.lines.fail("BVH003", f"unexpected {keyword} {context}", hint)
        if block is not None and block.is_end_site:
            self.lines.fail("BVH003", "unexpected JOINT inside an End Site")
        name = self._pop_name(words)
        if _CONTROL_PATTERN.search(name):
            message = f"the name {excerpt(name)} contains a control character"
            self.lines.fail("BVH001", message, "remove it")
        if not name:
            self.lines.fail("BVH003", f"{keyword} has no name")
        parent = block.joint_index if block else -1
        self.joints.append(BvhJoint(name, parent, self.lines.number))
        self.open_blocks.append(
            _OpenBlock(len(self.joints) - 1, False, self.lines.number)
        )

    def _parse_end_site(self, words: list[str], block: _OpenBlock | None) -> None:
        if block is None or block.is_end_site:
            self.lines.fail("BVH003", "unexpected End Site outside a joint")
        self._pop_name(words)
        self.open_blocks.append(_OpenBlock(block.joint_index, True, self.lines.number))

    @staticmethod
    def _pop_name(words: list[str]) -> str:
        """Remove and return a name, which may contain spaces, before a brace."""
        name = []
        while words and words[0] not in {"{", "}"}:
            name.append(words.pop(0))
        return " ".join(name)

    def _parse_offset(self, words: list[str], block: _OpenBlock | None) -> None:
        if block is None:
            self.lines.fail("BVH003", "unexpected OFFSET outside a joint")
        number_texts = [
            words.pop(0) for _ in range(3) if words and words[0] not in "{}"
        ]
        if len(number_texts) < 3 or (
            words and words[0].upper() not in _WORDS_AFTER_OFFSET
        ):
            count = len(number_texts) + sum(word not in "{}" for word in words)
            message = f"the OFFSET of {self._block_name(block)} has "
            self.lines.fail(
                "BVH006", f"{message}{counted(count, 'number')} instead of 3"
            )
        components = tuple(self._parse_number(text) for text in number_texts)
        offset = (components[0], components[1], components[2])
        block.has_offset = True
        if block.is_end_site:
            self.joints[block.joint_index].tips.append(offset)
        else:
            self.joints[block.joint_index].offset = offset

    def _parse_number(self, text: str) -> float:
        try:
            value = float("x" if "_" in text else text)
        except ValueError:
            hint = "write decimals with a point" if "," in text else None
            self.lines.fail("BVH006", f"{excerpt(text)} is not a number", hint)
        if not abs(value) <= FLOAT32_MAX:
            self.lines.fail("BVH006", f"OFFSET {text} is not a finite float32")
        return value

    def _parse_channels(self, words: list[str], block: _OpenBlock | None) -> None:
        if block is None or block.is_end_site:
            self.lines.fail("BVH003", "unexpected CHANNELS outside a joint")
        joint = self.joints[block.joint_index]
        if joint.channels is not None:
            message = f"{self._block_label(block)} has two CHANNELS lines"
            self.lines.fail("BVH007", message)
        if not words or not words[0].isdecimal():
            message = "CHANNELS needs a count first"
            self.lines.fail("BVH007", message, self._block_label(block))
        count = int(words.pop(0)[:9])
        names: list[str] = []
        while words and (len(names) < count or words[0].lower() in _CHANNELS):
            if words[0] in "{}":
                break
            names.append(words.pop(0))
        for name in names:
            if name.lower() not in _CHANNELS:
                message = f"unknown channel {excerpt(name)}"
                hint = f"allowed: {', '.join(CHANNEL_NAMES)}"
                self.lines.fail("BVH007", message, hint)
        if len(names) != count:
            message = f"CHANNELS of {self._block_label(block)} states {count}, but "
            message += f"names {len(names)}"
            hint = f"write CHANNELS {len(names)}, or the missing names"
            self.lines.fail("BVH007", message, hint)
        joint.channels = tuple(_CHANNELS[name.lower()] for name in names)
        if len(set(joint.channels)) != count:
            message, hint = _duplicate_channel(joint.channels)
            message += f" in CHANNELS of {self._block_label(block)}"
            self.lines.fail("BVH007", message, hint)

    def _check_complete(self) -> None:
        if self.open_blocks:
            message = "MOTION before all braces are closed"
            self.lines.fail("BVH004", message, self._missing_braces_hint())
        if not self.joints:
            self.lines.fail("BVH003", "the HIERARCHY has no ROOT")
        if not any(joint.channels for joint in self.joints):
            self.lines.fail("BVH007", "no joint has a channel")

    def _block_label(self, block: _OpenBlock) -> str:
        return f"{self._block_name(block)}, line {block.line}"

    def _block_name(self, block: _OpenBlock) -> str:
        block_kind = "End Site of" if block.is_end_site else "joint"
        name = excerpt(self.joints[block.joint_index].name)
        return f"{block_kind} {name}"

    def _missing_braces_hint(self) -> str | None:
        if not self.open_blocks:
            return None
        label, count = self._block_label(self.open_blocks[-1]), len(self.open_blocks)
        verb = "is" if count == 1 else "are"
        hint = f"{counted(count, 'closing brace')} {verb} missing, the innermost for "
        return f"{hint}{label}; copy or export the file again"


def read_header(lines: HeaderLines, path: str) -> tuple[BvhHeader, list[Fault]]:
    """Return the header of a BVH file, and notices about it."""
    parser = _HierarchyParser(lines)
    parser.parse()
    text = _read_field(lines, "frames")
    frames_line = lines.number
    try:
        frame_count = int(text)
    except ValueError:
        lines.fail("BVH008", f"Frames is {excerpt(text)}, not a whole number")
    if frame_count <= 0:
        lines.fail("BVH008", f"Frames is {frame_count}; at least 1 is needed")
    frame_time = _read_field(lines, "frame time")
    try:
        rate = rate_from_frame_time(frame_time)
    except ValueError:
        message = f"Frame Time is {excerpt(frame_time)}"
        hint = "a positive number of seconds is needed"
        if "," in frame_time and frame_time.replace(",", "").isdigit():
            hint = f"write {frame_time.replace(',', '.')}, with a decimal point"
        lines.fail("BVH009", message, hint)
    header = BvhHeader(parser.joints, frame_count, frames_line, frame_time, rate)
    notices = _duplicate_name_notices(header.joints, path)
    return header, notices + _rate_notices(header, path, lines.number)


def _read_field(lines: HeaderLines, name: str) -> str:
    """Return the text after ``name:`` on the next line that is not blank."""
    while (line := lines.next_line()) is not None and not line.strip():
        continue
    if line is None:
        message = f"the file ends before '{name.title()}:'"
        lines.fail("BVH005", message, _TRUNCATED_HINT)
    key, colon, value = line.partition(":")
    if not colon or " ".join(key.split()).lower() != name:
        message = f"expected '{name.title()}:', found {excerpt(line.strip())}"
        lines.fail("BVH003", message)
    return value.strip()


def _duplicate_name_notices(joints: list[BvhJoint], path: str) -> list[Fault]:
    lines_by_name: dict[str, list[int]] = {}
    for joint in joints:
        lines_by_name.setdefault(joint.name, []).append(joint.line)
    notices, hint = [], "rename them; until then, the later ones get a number"
    for name, line_numbers in lines_by_name.items():
        if len(line_numbers) > 1:
            message = f"joint name {excerpt(name)} appears {len(line_numbers)} times, "
            message += f"on lines {listed(line_numbers, 10)}"
            lines, warning = tuple(line_numbers), Severity.WARNING
            notices.append(Fault("BVH103", message, path, lines, hint, warning))
    return notices


def _rate_notices(header: BvhHeader, path: str, line: int) -> list[Fault]:
    rate_choice, frame_time = header.rate_choice, header.frame_time
    slowest, fastest = PLAUSIBLE_RATES
    hint = f"set the real rate with {argument('source.fps')}"
    severity = Severity.WARNING
    if not slowest <= rate_choice.fps <= fastest:
        code = "BVH105"
        message = f"Frame Time {frame_time} is {rate_label(rate_choice.fps)}, which is "
        message += "implausible"
        millisecond_rate = rate_of_milliseconds(frame_time)
        if millisecond_rate is not None:
            rate_text = rate_label(millisecond_rate)
            hint = f"it looks like milliseconds: {float(frame_time) / 1000:g} s are "
            hint += f"{rate_text}; set {argument('source.fps', rate_text.split()[0])}"
        elif slowest <= float(frame_time) <= fastest:
            hint = "is it a rate instead of a time? then set "
            hint += argument("source.fps", frame_time)
    elif rate_choice.kind is RateKind.PRINTED:
        code = "BVH106"
        message = f"Frame Time {frame_time} is not a standard rate; using "
        message += f"{rate_label(rate_choice.fps)}"
    elif rate_choice.ambiguous_rates:
        code, severity = "BVH107", Severity.NOTE
        other_rates = listed(rate_choice.ambiguous_rates, 6)
        is_exact = rate_choice.fps * Fraction(frame_time) == 1
        message = f"Frame Time {frame_time} {'may be' if is_exact else 'is'} rounded: "
        message += f"{other_rates} fps would be printed the same; using "
        message += rate_label(rate_choice.fps)
    else:
        return []
    return [Fault(code, message, path, (line,), hint, severity)]


def _duplicate_channel(channels: Sequence[str]) -> tuple[str, str]:
    """Return a message about a joint's repeated channel, and a hint to correct it.

    >>> _duplicate_channel(["Xrotation", "Xrotation", "Zrotation"])
    ("'Xrotation' appears twice", 'one of them is likely Yrotation')
    """
    name = next(name for name in channels if channels.count(name) > 1)
    count = channels.count(name)
    message = f"{name!r} appears {'twice' if count == 2 else f'{count} times'}"
    kind_suffix = name[1:]  # ``position`` or ``rotation``
    similar_channels = [
        channel for channel in channels if channel.endswith(kind_suffix)
    ]
    missing_channels = [
        n for n in CHANNEL_NAMES if n.endswith(kind_suffix) and n not in channels
    ]
    if len(similar_channels) == 3 and len(missing_channels) == 1:
        return message, f"one of them is likely {missing_channels[0]}"
    if len(similar_channels) == 3 and missing_channels:
        return message, f"two of them are likely {' and '.join(missing_channels)}"
    return message, "remove all but one, with its column of numbers"
