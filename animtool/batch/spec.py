"""The spec of a batch: inputs, outputs, limits, paths and versions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import field
from fractions import Fraction
from functools import cache
from pathlib import Path, PurePosixPath

from animtool.batch.overrides import Override
from animtool.batch.variants import Variants
from animtool.core.errors import excerpt
from animtool.core.record import dataclass
from animtool.scene.bake.options import BakeOptions

# Longer than any run, and within the range of system timers.
MAX_SECONDS = 1e9
MAX_BYTES = 10**18

_UNITS = {
    **{name: 1000**i for i, name in enumerate(("B", "KB", "MB", "GB", "TB"))},
    **{name: 1024**i for i, name in enumerate(("KiB", "MiB", "GiB", "TiB"), 1)},
}
_SIZE = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([KMGT]i?B|B)")


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of an item.

    Attributes:
        seconds: Of wall time; None is as long as it takes.
        memory: Of the process that makes it, all told [bytes]; None is any.
    """

    seconds: float | None = None
    memory: int | None = None


def parse_bytes(text: str) -> int:
    """Return the size [bytes] of a text such as ``2GB`` or ``512MiB``.

    >>> parse_bytes("1.5GB"), parse_bytes("2 KiB")
    (1500000000, 2048)
    """
    match = _SIZE.fullmatch(text.strip())
    size = float(match[1]) * _UNITS[match[2]] if match else 0.0
    if not 1 <= size <= MAX_BYTES:
        raise ValueError(f"{excerpt(text)} is not a size such as 2GB or 512MiB")
    return int(size)


def parse_seconds(text: str) -> float:
    """Return the time [s] of a text, above 0 and up to `MAX_SECONDS`."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds <= MAX_SECONDS:
        raise ValueError(f"{excerpt(text)} is not a number of seconds above 0")
    return seconds


def bytes_text(size: int) -> str:
    """Return a size as text.

    >>> bytes_text(1_500_000_000), bytes_text(20)
    ('1.5 GB', '20 B')
    """
    value, names = float(size), ["B", "KB", "MB", "GB", "TB"]
    while value >= 1000 and len(names) > 1:
        value, names = value / 1000, names[1:]
    return f"{value:.3g} {names[0]}"


UP = ".."


def relative_name(path: Path, root: Path) -> str:
    """Return a file's path relative to a folder; absolute without a common root.

    >>> relative_name(Path("/job/takes/a.bvh"), Path("/job/out"))
    '../takes/a.bvh'
    """
    where = path.absolute()
    # What a step up leads to is not known where a folder may be a link.
    if UP in where.parts or UP in root.parts:
        return where.as_posix()
    shared = 0
    for one, other in zip(where.parts, root.parts, strict=False):
        if one != other:
            break
        shared += 1
    if shared < 2:
        return where.as_posix()
    steps = [UP] * (len(root.parts) - shared)
    return PurePosixPath(*steps, *where.parts[shared:]).as_posix()


def path_of_name(name: str, root: Path) -> Path:
    """Return the file of a relative name; the inverse of `relative_name`.

    >>> path_of_name("../takes/a.bvh", Path("/job/out")).as_posix()
    '/job/takes/a.bvh'
    """
    path = Path(name)
    if path.is_absolute():
        return path
    steps = 0
    while steps < len(path.parts) and path.parts[steps] == UP:
        steps += 1
    # Above the uppermost folder is that itself.
    above = (root, *root.parents)[min(steps, len(root.parents))]
    return above.joinpath(*path.parts[steps:])


PACKAGES = ("animtool", "numpy", "scipy", "usd-core")
GROUPS = ("animtool.passes", "animtool.readers")


@cache
def package_versions() -> dict[str, str]:
    """Return the version of each package that affects results, plug-ins too.

    A package whose files were changed without another version is taken for the same.

    >>> sorted(package_versions())[0]
    'animtool'
    """
    from importlib.metadata import PackageNotFoundError, version

    from animtool.core.plugins import plugin_points

    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = ""
    for group in GROUPS:
        for point in plugin_points(group).values():
            if point.dist is not None:
                versions[point.dist.name] = point.dist.version
    return versions


@dataclass(frozen=True, slots=True)
class BatchSpec:
    """The spec of a batch.

    Attributes:
        inputs: Files, folders and globs, seen from ``folder``; a timeline among them
            is that of ``cuts``.
        folder: Where relative names start.
        name: What its records are called.
        exclude: What of the inputs is left out.
        scene: A scene that says what is done to each; None bakes each as it is.
        variables: What names in the scene and the output stand for.
        options: How to bake, where there is no scene.
        output: Pattern of the files to write; None is beside each input.
        limits: What each may take.
        jobs: How many processes; None is one for each processor.
        path: The batch file; None without one.
        cuts: A timeline whose clips are the items; None has one for each input.
        handles: Shot frames before and after the cuts of a timeline; None is as that
            says, else 0.
        variants: A table of values of which each row makes an item of each input; None
            makes one.
        roots: Folders that outputs may be in, as a batch file is of a project; empty is
            any.
        overrides: Other values of ``variables`` for some inputs; the last counts.
        fps: Rate of the outputs, and of a timeline's shots where it states none, as
            the command line says; None is as the scene or the options say.
        cut_start: First frame of each cut of a timeline; None is as that says.
        first_timecode: Of a timeline's media; None is as that says.
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
    def rows(self) -> Sequence[Mapping[str, str]]:
        """The variants; one without values where there are none."""
        return ({},) if self.variants is None else self.variants.rows
