"""The table of readers of rigs and motion, by file suffix.

The table contains names of readers; the functions are imported when used.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from animtool.core.arguments import flag
from animtool.core.errors import Fault, FormatError, OptionError
from animtool.core.files.reading import (
    exists,
    not_a_file_reason,
    open_input,
    unreadable_error,
)
from animtool.core.plugins import FormatTable, ListedEntry, load_object, suffix_text
from animtool.core.record import dataclass

PLUGIN_GROUP = "animtool.readers"


@dataclass(frozen=True, slots=True)
class Reader:
    """How files of a format are read: by which functions, with which options.

    Attributes:
        about: One-line description of such files.
        rig: ``module:object`` of a function from a path to a rig; empty if such files
            contain none.
        source: ``module:object`` of a function from a path, and options by keyword, to
            a stream of motion; empty if they contain none.
        options: Names of the source options that it accepts; ``progress`` if it reports
            the fraction read.
        prim: ``module:object`` of a function from a path, the name of an object in it,
            a rig, and the name of a reference object or None, to the object's
            transforms over time; empty if they contain none.
        markers: ``module:object`` of a function from a path, and options by keyword, to
            `animtool.motion.markers.Markers`; empty if such files contain none.
        has_markers: ``module:object`` of a function from a path to whether a file
            contains markers; empty if its suffix determines it.
        takes: ``module:object`` of a function from a path to the names of the takes for
            the option ``take``; empty if a file contains one take.
        still: Whether such files contain a rig without motion, so that their take is
            one frame.
    """

    about: str
    rig: str = ""
    source: str = ""
    options: tuple[str, ...] = ()
    prim: str = ""
    markers: str = ""
    has_markers: str = ""
    takes: str = ""
    still: bool = False

    def rig_opener(self, path: Path) -> Callable[[Path], Any]:
        """Return the function that opens a rig; see `source_opener`."""
        return _load_opener(self.rig, "rig", path)

    def source_opener(self, path: Path) -> Callable[..., Any]:
        """Return the opener of a source (unsupported: IO002; broken: IO003)."""
        return _load_opener(self.source, "motion", path)

    def prim_opener(self, path: Path) -> Callable[..., Any]:
        """Return the function that opens an object; see `source_opener`."""
        return _load_opener(self.prim, "prim", path)

    def take_names(self, path: Path) -> list[str]:
        """Return the names of a file's takes; empty if the format has one take."""
        if not self.takes:
            return []
        return list(_load_opener(self.takes, "takes", path)(path))

    def markers_opener(self, path: Path) -> Callable[..., Any]:
        """Return the function that opens markers; see `source_opener`."""
        return _load_opener(self.markers, "markers", path)


# A zip file of a stage and its dependencies.
USD_PACKAGE_SUFFIX = ".usdz"

BVH = Reader(
    "Biovision Hierarchy",
    "animtool.formats.bvh.read:read_bvh_rig",
    "animtool.formats.bvh.read:read_bvh",
    ("unit", "up", "fps", "positions", "progress"),
)
USD = Reader(
    "USD",
    "animtool.usd.rigs.stored:read_rig",
    "animtool.usd.takes.read:read_usd",
    ("prim_path", "take", "placement"),
    "animtool.usd.props.prim_transforms:prim_transform_reader",
)
GLTF = Reader(
    "glTF",
    "animtool.formats.gltf.read:read_gltf_rig",
    "animtool.formats.gltf.read:read_gltf",
    ("unit", "up", "fps", "prim_path", "take"),
    takes="animtool.formats.gltf.read:take_names",
)
FBX = Reader(
    "FBX",
    "animtool.formats.fbx.read:read_fbx_rig",
    "animtool.formats.fbx.read:read_fbx",
    ("unit", "up", "fps", "prim_path", "take"),
    takes="animtool.formats.fbx.read:take_names",
)
URDF = Reader(
    "URDF robots",
    "animtool.formats.urdf.read:read_urdf_rig",
    "animtool.formats.urdf.read:read_urdf",
    still=True,
)
MJCF = Reader(
    "MJCF models of MuJoCo",
    "animtool.formats.mjcf.read:read_mjcf_rig",
    "animtool.formats.mjcf.read:read_mjcf",
    still=True,
)
RIG_AND_CLIP_FILES = Reader(
    "rig and clip files",
    "animtool.rig.file:load_rig",
    "animtool.scene.sources.clips:open_clip_source",
    ("rig", "clamp"),
)

LIVELINK = Reader(
    "Live Link Face recordings",
    "animtool.formats.livelink.read:read_livelink_rig",
    "animtool.formats.livelink.read:read_livelink",
    ("rig", "fps", "remap", "dropped"),
)

MOT = Reader(
    "OpenSim motion",
    "animtool.formats.mot.read:read_mot_rig",
    "animtool.formats.mot.read:read_mot",
    ("rig", "fps"),
)

STO = Reader(
    "OpenSim storage",
    "animtool.formats.mot.read:read_mot_rig",
    "animtool.formats.mot.read:read_mot",
    ("rig", "fps"),
    markers="animtool.formats.mot.points:read_points",
    has_markers="animtool.formats.mot.points:holds_points",
)

_MARKER_OPTIONS = ("unit", "up", "fps", "rig", "template", "progress")
_OPEN_MARKERS = "animtool.capture.solve.source:open_markers_source"
C3D = Reader(
    "C3D markers",
    source=_OPEN_MARKERS,
    options=_MARKER_OPTIONS,
    markers="animtool.formats.c3d.read:read_c3d",
)
TRC = Reader(
    "TRC markers",
    source=_OPEN_MARKERS,
    options=_MARKER_OPTIONS,
    markers="animtool.formats.trc.read:read_trc",
)
MARKER_ARRAYS = Reader(
    "arrays of markers",
    source=_OPEN_MARKERS,
    options=(*_MARKER_OPTIONS, "cameras"),
    markers="animtool.formats.marker_arrays:read_markers",
)

READERS: dict[str, Reader] = {
    ".bvh": BVH,
    ".usd": USD,
    ".usda": USD,
    ".usdc": USD,
    USD_PACKAGE_SUFFIX: USD,
    ".glb": GLTF,
    ".gltf": GLTF,
    ".vrm": GLTF,
    ".fbx": FBX,
    ".urdf": URDF,
    ".mjcf": MJCF,
    ".xml": MJCF,
    ".yaml": RIG_AND_CLIP_FILES,
    ".yml": RIG_AND_CLIP_FILES,
    ".json": RIG_AND_CLIP_FILES,
    ".csv": LIVELINK,
    ".c3d": C3D,
    ".trc": TRC,
    ".npz": MARKER_ARRAYS,
    ".mot": MOT,
    ".sto": STO,
}

# Formats of OpenTimelineIO and its adapters.
TIMELINE_SUFFIXES = (
    ".otio",
    ".otioz",
    ".otiod",
    ".edl",
    ".fcpxml",
    ".xml",
    ".aaf",
    ".xges",
)


# Formats of applications, with the formats to export to.
EXPORT_HINTS: dict[str, tuple[str, str]] = {
    ".ma": ("a Maya scene", "export FBX, glTF or USD from Maya, then use that file"),
    ".mb": ("a Maya scene", "export FBX, glTF or USD from Maya, then use that file"),
    ".anim": (
        "animation from Maya or Unity, without its skeleton",
        "export FBX or USD of the animated skeleton, then use that file",
    ),
    ".blend": (
        "a Blender file",
        "export glTF, FBX or USD from Blender, then use that file",
    ),
    ".max": ("a 3ds Max scene", "export FBX or USD from 3ds Max, then use that file"),
    **dict.fromkeys(
        (".hip", ".hiplc", ".hipnc"),
        ("a Houdini scene", "export USD, FBX or glTF from Houdini, then use that file"),
    ),
    ".abc": (
        "Alembic, which stores points but no joints",
        "export FBX, glTF or USD of the skeleton from the tool that wrote it",
    ),
    ".xacro": (
        "macros that a URDF is made from",
        "expand it by xacro, of ROS: xacro robot.urdf.xacro -o robot.urdf",
    ),
    ".sdf": (
        "SDF, a world or robot of Gazebo",
        "use the URDF or MJCF that it was made from",
    ),
    ".dae": (
        "COLLADA",
        "import it into Blender or Maya and export glTF or FBX, then use that file",
    ),
}

_TABLE = FormatTable(READERS, PLUGIN_GROUP, Reader)
# Number of bytes that are searched for the root element of an .xml file, and the root
# elements of timelines, which OpenTimelineIO reads.
MAX_ROOT_SEARCH_BYTES = 65_536
_ROOT_ELEMENT = re.compile(rb"<(?![?!])\s*([^\s/>]{1,100})")
_XML_COMMENTS = re.compile(rb"<!--.*?(?:-->|\Z)", re.DOTALL)
_TIMELINE_ROOTS = frozenset({"xmeml", "fcpxml"})


def xml_root(path: Path) -> str:
    """Return the name of the root element of an XML file; "" if there is none."""
    try:
        with open_input(path, None, is_recorded=False) as file:
            first_bytes = file.read(MAX_ROOT_SEARCH_BYTES)
    except FormatError:
        return ""
    match = _ROOT_ELEMENT.search(
        _XML_COMMENTS.sub(b"", first_bytes.replace(b"\0", b""))
    )
    return match[1].decode("utf-8", "replace") if match else ""


def is_timeline(path: Path) -> bool:
    """Return whether a path is a timeline; ``.xml`` is detected by its root element.

    >>> is_timeline(Path("edit.otio")), is_timeline(Path("walk.bvh"))
    (True, False)
    """
    suffix = path.suffix.lower()
    if suffix in READERS:
        return suffix in TIMELINE_SUFFIXES and xml_root(path) in _TIMELINE_ROOTS
    return suffix in TIMELINE_SUFFIXES


def reader_of(path: Path) -> Reader | None:
    """Return the reader of a file by its suffix; None if there is none.

    A timeline named .xml has no reader.

    >>> reader_of(Path("walk.txt")) is None
    True
    """
    return None if is_timeline(path) else _TABLE.find(path)


def is_rig_only(path: Path) -> bool:
    """Return whether files with this suffix contain a rig but no motion.

    >>> is_rig_only(Path("arm.urdf")), is_rig_only(Path("walk.bvh"))
    (True, False)
    """
    reader = reader_of(path)
    return reader is not None and reader.still


def readable_suffixes() -> list[str]:
    """Return all readable suffixes, with those of plug-ins at the end."""
    return [*READERS, *_TABLE.plugin_suffixes()]


def find_reader(path: Path) -> Reader:
    """Return the reader of a file by its suffix, or of a plug-in (unknown: IO002).

    >>> find_reader(Path("walk.BVH")).about
    'Biovision Hierarchy'
    """
    reader = reader_of(path)
    if reader is not None:
        return reader
    reason = not_a_file_reason(path)
    if reason is not None:
        missing_reason = FileNotFoundError() if not exists(path) else reason
        raise unreadable_error(path, missing_reason)
    if path.suffix.lower() in EXPORT_HINTS:
        raise OptionError(export_fault(path))
    message = f"{suffix_text(path)} is not a format that animtool reads"
    hint = f"allowed: {', '.join(readable_suffixes())}"
    if is_timeline(path):
        message = "is a timeline, not a take"
        hint = (
            f"animtool bake {flag('shot', 'NAME')} bakes one of its shots, animtool "
            "batch all of them"
        )
    raise OptionError(Fault("IO002", message, str(path), (), hint))


def export_fault(path: Path) -> Fault:
    """Return a fault for a file that must be exported before it is read (IO002)."""
    about, hint = EXPORT_HINTS[path.suffix.lower()]
    message = f"{path.suffix} is not read: it is {about}"
    return Fault("IO002", message, str(path), (), hint)


# What to give in place of a file without some content.
_ALTERNATIVE_HINTS = {
    "markers": "give a .c3d, .trc or .npz of markers",
    "motion": "give a take, such as .bvh, .fbx or .usd; animtool mocap solve moves a "
    "rig by markers",
    "rig": "give a .rig.yaml, .usd, .bvh, .glb, .fbx or .urdf",
    "takes": "give the name of a file with takes, such as .usd, .fbx or .glb",
}


def _load_opener(target: str, content: str, path: Path) -> Callable[..., Any]:
    if not target:
        message = f"{path.suffix} files hold no {content}"
        hint = _ALTERNATIVE_HINTS.get(content)
        if content == "markers":
            command = f"animtool bake {path} -o {path.stem}.usdc"
            hint = f"{hint}; to bake the take in this file: {command}"
        raise OptionError(Fault("IO002", message, str(path), (), hint))
    try:
        return cast(Callable[..., Any], load_object(target))
    except (ImportError, AttributeError) as error:
        message = f"the reader {target} cannot be loaded: {error}"
        hint = "repair or remove the plug-in"
        raise OptionError(Fault("IO003", message, str(path), (), hint)) from error


def listed_readers() -> list[ListedEntry]:
    """Return all readers, built-in ones first, with plug-ins loaded.

    >>> listed_readers()[0].name
    '.bvh'
    """
    return _TABLE.listed(_content_names, lambda reader: reader.about)


def _content_names(reader: Reader) -> tuple[str, ...]:
    objects = {"rig": reader.rig, "source": reader.source, "markers": reader.markers}
    return tuple(name for name, target in objects.items() if target)
