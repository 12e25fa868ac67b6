"""The table of writers of takes, rigs and markers, by file suffix.

The table contains names of writers; the functions are imported when used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from animtool.core.errors import Fault, OptionError
from animtool.core.files.reading import exists
from animtool.core.names import FILE_KINDS, has_kind_suffix
from animtool.core.plugins import FormatTable, ListedEntry, load_object, suffix_text
from animtool.core.record import dataclass

PLUGIN_GROUP = "animtool.writers"


@dataclass(frozen=True, slots=True)
class Writer:
    """How files of a format are written: by which functions, with which options.

    Attributes:
        name: Name of the format in reports, such as ``bvh``.
        about: One-line description of such files.
        take: ``module:object`` of a function from a take, a path and
            `animtool.motion.take_files.WriteOptions` to the files to write; empty if
            such files contain no motion, or it is written by ``stage``.
        text: ``module:object`` of a function from a take with a sample on every frame
            to `animtool.formats.take_text.TakeText`, for a format of one file and one
            row per frame; instead of ``take``.
        stage: Whether it is USD, which a bake writes block by block.
        markers: ``module:object`` of a function from markers, a path and ``overwrite``
            to a description of lost content; empty if such files contain no markers.
        rig: ``module:object`` of a function from an
            `animtool.scene.convert.rigs.RigJob` to its report, which writes a rig;
            empty if such files contain none.
        sidecars: Suffixes of files that are written next to the output.
        options: Names of the bake options that apply only to such files.
        holds: Parts of a take that can be stored: ``joints``, ``shapes``, ``controls``,
            ``meshes``.
        samples: Stored samples, as described in a plan.
        numbered: Whether times in the file determine the number of the first frame.
        several: Whether one file contains several takes of a rig, by name.
    """

    name: str
    about: str
    take: str = ""
    text: str = ""
    stage: bool = False
    markers: str = ""
    rig: str = ""
    sidecars: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    holds: frozenset[str] = frozenset()
    samples: str = "samples of rotations"
    numbered: bool = False
    several: bool = False

    @property
    def holds_motion(self) -> bool:
        """Whether the format can store a take."""
        return self.stage or bool(self.take or self.text)

    def files(self, path: Path) -> list[Path]:
        """Return the files of an output, the main file last.

        Files that not every take has are omitted.

        >>> [one.name for one in CLIP.files(Path("walk.clip.yaml"))]
        ['walk.rig.yaml', 'walk.clip.yaml']
        """
        stem = output_stem(path)
        return [*(path.with_name(f"{stem}{suffix}") for suffix in self.sidecars), path]


def output_stem(path: Path) -> str:
    """Return a file name without the suffix of its format."""
    return path.name.removesuffix(path.suffix).removesuffix(".clip")


USD = Writer("usd", "USD", stage=True, rig="animtool.scene.convert.rigs:rig_to_usd")
# Archives contain complete stages: no layer is written over one.
USDZ = replace(USD, rig="")
RIG = Writer(
    "rig",
    "rig files, with arrays next to them",
    rig="animtool.scene.convert.rigs:rig_to_file",
)
CLIP = Writer(
    "clip",
    "clip files, keys within a tolerance",
    "animtool.clip.written:build_clip_files",
    sidecars=(".rig.yaml",),
    options=("reduce", "reduce_at"),
    holds=frozenset({"joints", "shapes", "controls", "meshes"}),
    samples="keys within a tolerance",
)
BVH = Writer(
    "bvh",
    "Biovision Hierarchy",
    text="animtool.formats.bvh.write:build_bvh_text",
    holds=frozenset({"joints"}),
)
LIVELINK = Writer(
    "csv",
    "Live Link Face recordings",
    text="animtool.formats.livelink.write:build_livelink_text",
    holds=frozenset({"shapes"}),
    samples="weights of ARKit's shapes",
)
_MOT_TEXT = "animtool.formats.mot.write:build_mot_text"
MOT, STO = (
    Writer(
        name,
        about,
        text=_MOT_TEXT,
        holds=frozenset({"joints"}),
        samples="samples of joint coordinates",
        numbered=True,
    )
    for name, about in (("mot", "OpenSim motion"), ("sto", "OpenSim storage"))
)
GLTF = Writer(
    "gltf",
    "glTF",
    "animtool.formats.gltf.write:build_gltf_files",
    options=("reduce",),
    holds=frozenset({"joints", "shapes", "meshes"}),
    samples="samples, or the keys of a clip",
    several=True,
)
C3D = Writer("c3d", "C3D markers", markers="animtool.formats.c3d.write:write_c3d")
TRC = Writer("trc", "TRC markers", markers="animtool.formats.trc.write:write_trc")
WRITERS: dict[str, Writer] = {
    ".bvh": BVH,
    ".usd": USD,
    ".usda": USD,
    ".usdc": USD,
    ".usdz": USDZ,
    ".rig.yaml": RIG,
    ".yaml": CLIP,
    ".yml": CLIP,
    ".glb": GLTF,
    ".gltf": GLTF,
    ".csv": LIVELINK,
    ".mot": MOT,
    ".sto": STO,
    ".c3d": C3D,
    ".trc": TRC,
    ".npz": Writer(
        "npz",
        "arrays of markers",
        markers="animtool.formats.marker_arrays:write_marker_arrays",
    ),
}


_TABLE = FormatTable(WRITERS, PLUGIN_GROUP, Writer)


def writer_of(path: Path) -> Writer | None:
    """Return the writer of a file by its suffix; None if there is none.

    >>> writer_of(Path("walk.MOT")).about
    'OpenSim motion'
    """
    return _TABLE.find(path)


def take_writer(path: Path, *, allows_folders: bool = False) -> Writer:
    """Return the writer of a take for an output path (none: OUT004).

    allows_folders: whether an output may be a folder, which the hint then mentions.
    """
    writer = writer_of(path)
    if writer is not None and writer.holds_motion:
        kind = Path(path.stem).suffix.lower().removeprefix(".")
        if writer is not CLIP or kind not in FILE_KINDS or kind == "clip":
            return writer
        message = f"is the name of a {kind} file, which holds no motion"
    elif writer is not None:
        message = f"holds {writer.about}, not motion of joints"
    else:
        message = f"{suffix_text(path)} is not a format that animtool writes"
        if not path.suffix:
            message = "has no suffix, which tells the format"
            if path.name in WRITERS:
                message = f"has only a suffix, {path.name}, and no name before it"
    hint = f"allowed: {', '.join(_motion_suffixes())}"
    if writer is None and path.suffix.lower() in _READ_ONLY_FORMATS:
        message, hint = _read_only_error_parts(path)
    if not path.suffix and path.name and exists(path) and path.is_dir():
        message = "is a folder, not a file"
        hint = f"name a file in it, such as {path / 'shot.usdc'}"
    elif not path.suffix:
        hint += f"; {path}/ is a folder" if allows_folders else ""
    raise OptionError(Fault("OUT004", message, str(path), (), hint))


_ROBOT_HINT = (
    "write .rig.yaml or USD of the robot, and USD, .mot or .clip.yaml of its motion"
)
# Read-only formats, and their replacements for writing, by suffix.
_READ_ONLY_FORMATS = {
    ".fbx": (
        "FBX",
        "write .usdc for Maya, Houdini, Unreal and Blender, .glb for Blender, Unity "
        "and Unreal, .bvh for MotionBuilder and 3ds Max",
    ),
    ".urdf": ("URDF", _ROBOT_HINT),
    ".mjcf": ("MJCF", _ROBOT_HINT),
    ".xml": ("MJCF", _ROBOT_HINT),
}


def _read_only_error_parts(path: Path) -> tuple[str, str]:
    """Return the message and the hint for a format that cannot be written."""
    name, hint = _READ_ONLY_FORMATS[path.suffix.lower()]
    return f"{name} is read, and not written", hint


def holds_rig(path: Path) -> bool:
    """Return whether a file name has the suffix of a rig format.

    >>> holds_rig(Path("arm.usda")), holds_rig(Path("arm.bvh"))
    (True, False)
    """
    return bool(_rig_function(path))


def _rig_function(path: Path) -> str:
    """Return the ``module:object`` that writes a rig to a file; "" if none does."""
    writer = RIG if has_kind_suffix(path, "rig") else writer_of(path)
    return "" if writer is None else writer.rig


def marker_writer(path: Path) -> Callable[..., list[Fault]]:
    """Return the function that writes markers to a file (else OUT004)."""
    writer = writer_of(path)
    if writer is None or not writer.markers:
        message = f"{suffix_text(path)} is not a format for markers"
        suffixes = [suffix for suffix, other in WRITERS.items() if other.markers]
        hint = f"allowed: {', '.join(suffixes)}"
        raise OptionError(Fault("OUT004", message, str(path), (), hint))
    return cast(Callable[..., list[Fault]], load_object(writer.markers))


def rig_writer(path: Path) -> Callable[..., Any]:
    """Return the function that writes a rig to a file (else OUT004)."""
    function = _rig_function(path)
    if not function:
        message = f"suffix {path.suffix!r} cannot hold a rig"
        suffixes = [suffix for suffix, other in WRITERS.items() if other.rig]
        hint = f"allowed: {', '.join(sorted(suffixes))}"
        if path.suffix.lower() in _READ_ONLY_FORMATS:
            message, hint = _read_only_error_parts(path)
        raise OptionError(Fault("OUT004", message, str(path), (), hint))
    return cast(Callable[..., Any], load_object(function))


def writes_stage(path: Path) -> bool:
    """Return whether the suffix of an output path is that of a USD stage."""
    writer = WRITERS.get(path.suffix.lower())
    return writer is not None and writer.stage


def file_suffixes() -> list[str]:
    """Return the suffixes of take formats other than USD, without plug-ins.

    >>> file_suffixes()[:2]
    ['.bvh', '.clip.yaml']
    """
    return sorted(
        ".clip.yaml" if writer is CLIP else suffix
        for suffix, writer in WRITERS.items()
        if (writer.take or writer.text) and suffix != ".yml"
    )


def _motion_suffixes() -> list[str]:
    """Return the suffixes of all take formats, including plug-ins."""
    stage_suffixes = [suffix for suffix, writer in WRITERS.items() if writer.stage]
    return [*sorted([*stage_suffixes, *file_suffixes()]), *_TABLE.plugin_suffixes()]


def listed_writers() -> list[ListedEntry]:
    """Return all writers, built-in ones first, with plug-ins loaded.

    >>> listed_writers()[0].name
    '.bvh'
    """
    return _TABLE.listed(_content_names, lambda writer: writer.about)


def _content_names(writer: Writer) -> tuple[str, ...]:
    contents: dict[str, Any] = {
        "motion": writer.holds_motion,
        "markers": writer.markers,
        "rig": writer.rig,
    }
    return tuple(name for name, is_supported in contents.items() if is_supported)
