"""The request for a batch: inputs, outputs and limits; file names and versions."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, replace
from fractions import Fraction
from functools import cache
from itertools import takewhile
from pathlib import Path, PurePosixPath

from animtool.batch.variants import Variants
from animtool.core.errors import excerpt
from animtool.core.record import dataclass
from animtool.scene.bake.options import BakeOptions

# Longer than any run, and within the range of system timers.
MAX_LIMIT_SECONDS = 1e9
MAX_LIMIT_BYTES = 10**18

_BYTES_PER_UNIT = {
    **{name: 1000**i for i, name in enumerate(("B", "KB", "MB", "GB", "TB"))},
    **{name: 1024**i for i, name in enumerate(("KiB", "MiB", "GiB", "TiB"), 1)},
}
_SIZE_PATTERN = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([KMGT]i?B|B)")


@dataclass(frozen=True, slots=True)
class Limits:
    """Time and memory that building one item may take.

    Attributes:
        seconds: Limit of wall time; None for no limit.
        memory: Memory limit of the building process [bytes]; None for no limit.
    """

    seconds: float | None = None
    memory: int | None = None


def parse_bytes(text: str) -> int:
    """Return the size [bytes] of a text such as ``2GB`` or ``512MiB``.

    >>> parse_bytes("1.5GB"), parse_bytes("2 KiB")
    (1500000000, 2048)
    """
    match = _SIZE_PATTERN.fullmatch(text.strip())
    size = float(match[1]) * _BYTES_PER_UNIT[match[2]] if match else 0.0
    if not 1 <= size <= MAX_LIMIT_BYTES:
        raise ValueError(f"{excerpt(text)} is not a size such as 2GB or 512MiB")
    return int(size)


def parse_seconds(text: str) -> float:
    """Return the time [s] of a text, above 0 and up to `MAX_LIMIT_SECONDS`."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds <= MAX_LIMIT_SECONDS:
        raise ValueError(f"{excerpt(text)} is not a number of seconds above 0")
    return seconds


PARENT_FOLDER = ".."


def relative_name(path: Path, root: Path) -> str:
    """Return a file's path relative to a folder, or absolute if they share none.

    >>> relative_name(Path("/job/takes/a.bvh"), Path("/job/out"))
    '../takes/a.bvh'
    """
    absolute_path = path.absolute()
    # The target of a step up is unknown if a folder is a link.
    if PARENT_FOLDER in absolute_path.parts or PARENT_FOLDER in root.parts:
        return absolute_path.as_posix()
    part_pairs = zip(absolute_path.parts, root.parts, strict=False)
    common_count = len(list(takewhile(lambda pair: pair[0] == pair[1], part_pairs)))
    if common_count < 2:
        return absolute_path.as_posix()
    steps_up = [PARENT_FOLDER] * (len(root.parts) - common_count)
    return PurePosixPath(*steps_up, *absolute_path.parts[common_count:]).as_posix()


def path_of_name(name: str, root: Path) -> Path:
    """Return the file of a relative name, as the inverse of `relative_name`.

    >>> path_of_name("../takes/a.bvh", Path("/job/out")).as_posix()
    '/job/takes/a.bvh'
    """
    path = Path(name)
    if path.is_absolute():
        return path
    up_count = len(list(takewhile(PARENT_FOLDER.__eq__, path.parts)))
    # The topmost folder is its own parent.
    ancestor = (root, *root.parents)[min(up_count, len(root.parents))]
    return ancestor.joinpath(*path.parts[up_count:])


VERSIONED_PACKAGES = ("animtool", "numpy", "scipy", "usd-core")
VERSIONED_PLUGIN_GROUPS = ("animtool.passes", "animtool.readers")


@cache
def package_versions() -> dict[str, str]:
    """Return the version of each package that affects results, including plug-ins.

    Changes of a package's files without a new version are not detected.

    >>> sorted(package_versions())[0]
    'animtool'
    """
    from importlib.metadata import PackageNotFoundError, version

    from animtool.core.plugins import plugin_entry_points

    versions = {}
    for name in VERSIONED_PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = ""
    for group in VERSIONED_PLUGIN_GROUPS:
        for entry_point in plugin_entry_points(group).values():
            if entry_point.dist is not None:
                versions[entry_point.dist.name] = entry_point.dist.version
    return versions


@dataclass(frozen=True, slots=True)
class Override:
    """Values of variables for the inputs that match any of the patterns.

    Attributes:
        inputs: Files, folders and globs, relative to the folder of the batch.
        variables: Values by name.
    """

    inputs: tuple[str, ...]
    variables: Mapping[str, str] = field(default_factory=dict)

    def without_names(self, names: Collection[str]) -> Override:
        """Return a copy that does not override the named variables."""
        items = self.variables.items()
        return replace(self, variables={n: v for n, v in items if n not in names})


@dataclass(frozen=True, slots=True)
class BatchSpec:
    """The request for a batch, before its inputs are searched for.

    Attributes:
        inputs: Files, folders and globs, relative to ``folder``; a timeline among them
            is used as ``cuts``.
        folder: Base folder of relative names.
        name: Name of its records.
        exclude: Inputs to leave out.
        scene: A scene that is applied to each input; None bakes each as it is.
        variables: Values of names in the scene and the output.
        options: Bake options without a scene.
        output: Pattern of the files to write; None writes next to each input.
        limits: Limits of each item.
        jobs: Number of processes; None uses one per processor.
        path: The batch file; None if there is none.
        cuts: A timeline whose clips are the items; None has one item per input.
        handles: Shot frames before and after the cuts of a timeline; None uses its
            metadata, else 0.
        variants: A table of values; each row makes an item of each input; None makes
            one.
        roots: Folders that outputs may be in, for a batch file of a project; empty for
            any.
        overrides: Other values of ``variables`` for some inputs; the last match counts.
        fps: Rate of the outputs, and of a timeline's shots without a stated rate, from
            the command line; None uses that of the scene or the options.
        cut_start: First frame of each cut of a timeline; None uses the timeline's.
        first_timecode: Time code of a timeline's media; None uses the timeline's.
    """

    inputs: tuple[str, ...]
    folder: Path = Path()
    name: str = "batch"
    exclude: tuple[str, ...] = ()
    scene: Path | None = None
    variables: Mapping[str, str] = field(default_factory=dict)
    options: BakeOptions = field(default_factory=BakeOptions)
    output: str | None = None
    limits: Limits = field(default_factory=Limits)
    jobs: int | None = None
    path: Path | None = None
    cuts: Path | None = None
    handles: int | None = None
    variants: Variants | None = None
    roots: tuple[Path, ...] = ()
    overrides: tuple[Override, ...] = ()
    fps: Fraction | None = None
    cut_start: int | None = None
    first_timecode: str | None = None

    @property
    def path_text(self) -> str | None:
        """Path of the batch file for faults; None if there is none."""
        return None if self.path is None else str(self.path)

    @property
    def rows(self) -> Sequence[Mapping[str, str]]:
        """The variants; one row without values if there are no variants."""
        return ({},) if self.variants is None else self.variants.rows
