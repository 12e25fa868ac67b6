"""Opens files of every kind for a page."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.clip.clip import Clip
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    Severity,
    counted,
    listed,
)
from animtool.core.files.reading import record_input
from animtool.core.names import has_kind_suffix
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, unit_name
from animtool.formats.marker_files import is_marker_file, open_markers
from animtool.ik.file import load_targets
from animtool.ik.tracks import TargetTracks
from animtool.motion.markers import Markers
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import reorient
from animtool.motion.take import TakeStream
from animtool.preview.options import PreviewOptions
from animtool.rig.kinematics import bind_matrices
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import (
    Strands,
    Surface,
    rotate_unskinned,
    strands_of,
    surfaces_of,
)
from animtool.scene.sources.open import (
    SourceOptions,
    fitting_options,
    is_usd,
    open_characters,
    open_source,
    source_stem,
    supports_option,
)

if TYPE_CHECKING:
    from animtool.scene.scene import Scene
    from animtool.usd.caches.shown import StageContents

# Kinds of files that cannot be shown by themselves, with a hint on what to open
# instead.
_UNSUPPORTED_HINTS = {
    "batch": "preview its output",
    "cameras": "preview a file that uses it",
    "landmarks": "preview a file that uses it",
    "map": "preview a file that uses it",
    "markers": "preview a file of its markers",
    "remap": "preview a file that uses it",
}


@dataclass(frozen=True, slots=True)
class TakeToShow:
    """A take of a file, rotated to Y up, with its meshes."""

    name: str
    stream: TakeStream
    bind: FloatArray  # ``(J, 4, 4)`` [m]
    surfaces: tuple[Surface, ...] = ()
    strands: tuple[Strands, ...] = ()
    clip: Clip | None = None
    prim: str = ""  # path of its Skeleton on the stage
    # Linear colors by mesh name, per point ``(V, 3)`` or one for the mesh ``(1, 3)``.
    colors: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(slots=True)
class OpenFile:
    """A file opened for a page: its takes and other contents to show.

    Attributes:
        path: Path of the file, as given by the user.
        unit: Unit of length of the file.
        up: Up axis of the file.
        takes: Its characters.
        contents: Other prims of its stage; None for other files.
        markers: Its markers, Y up; None for other files.
        targets: Its IK targets; None for other files.
        notices: Warnings and notes about the file.
        folder: Folder of a scene's temporary bake; None for files read directly.
    """

    path: Path
    unit: str = "m"
    up: str = "Y"
    takes: list[TakeToShow] = field(default_factory=list)
    contents: StageContents | None = None
    markers: Markers | None = None
    targets: TargetTracks | None = None
    notices: list[Fault] = field(default_factory=list)
    folder: Path | None = None

    def relocated_to_scene(self, fault: Fault) -> Fault:
        """Return a fault located at the scene instead of its temporary layer."""
        fault_path = fault.path
        if (
            self.folder is None
            or not fault_path
            or not Path(fault_path).is_relative_to(self.folder)
        ):
            return fault
        return replace(fault, path=str(self.path))

    @property
    def fps(self) -> Fraction | None:
        """Frame rate; None for a rig at rest."""
        if self.takes:
            return self.takes[0].stream.fps
        if self.markers is not None:
            return self.markers.clock.fps
        if self.targets is not None:
            return self.targets.clock.fps
        return None if self.contents is None else self.contents.fps


def open_file(
    path: Path, options: PreviewOptions, all_files: Sequence[Path], context: ExitStack
) -> OpenFile:
    """Open a file of any supported kind.

    Args:
        path: The file.
        options: How to read it.
        all_files: All files of the page; an option may apply to some of them only.
        context: Keeps resources open until the page is built.
    """
    for kind, hint in _UNSUPPORTED_HINTS.items():
        if has_kind_suffix(path, kind):
            message = f"is a {kind} file, which has nothing to show by itself"
            raise OptionError(Fault("PRV001", message, str(path), (), hint))
    if options.over and not any(
        is_usd(file) or has_kind_suffix(file, "scene") for file in all_files
    ):
        message = f"a layer goes over a USD file or a scene, and {path} is neither"
        hint = f"animtool bake {path} -o {source_stem(path)}.usdc writes a USD file"
        raise OptionError(Fault("PRV006", message, hint=hint, where="over"))
    if has_kind_suffix(path, "scene"):
        return _open_scene(path, options, context)
    if has_kind_suffix(path, "rig"):
        return _open_rig(path)
    if has_kind_suffix(path, "targets"):
        return _open_targets(path, is_only_file=len(all_files) == 1)
    source_options = replace(
        fitting_options(options.source, path, all_files), prim_path=options.prim_path
    )
    if not supports_option(path, "prim_path"):
        source_options = replace(source_options, prim_path=None)
    if is_marker_file(path) and source_options.template is None:
        return _open_markers(path, source_options)
    if is_usd(path):
        readable_path = path
        if options.over:
            folder = Path(
                context.enter_context(tempfile.TemporaryDirectory("animtool"))
            )
            readable_path = _combined_stage(folder, path, options)
        file = _open_stage(readable_path, path.name, source_options)
        file.path = path
        return file
    stream = open_source(path, source_options)
    file = OpenFile(path, unit_name(stream.rig.meters_per_unit), stream.rig.up)
    clip = None
    if has_kind_suffix(path, "clip"):
        clip = Clip.load(path, stream.rig)
    file.takes.append(take_of_stream(source_stem(path), stream, clip))
    return file


def take_of_stream(
    name: str, stream: TakeStream, clip: Clip | None = None
) -> TakeToShow:
    """Return a take, rotated to Y up, with the meshes of its rig."""
    stream = reorient(stream, UpAxis.Y)
    rig = stream.rig
    bind = bind_matrices(rig)
    return TakeToShow(name, stream, bind, surfaces_of(rig), strands_of(rig), clip)


def rest_take(rig: Rig) -> TakeStream:
    """Return a one-frame take of a rig at rest."""
    motion = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
    )
    first_frame = Fraction(1)
    return TakeStream(rig, Fraction(24), first_frame, first_frame, iter([motion]))


def _open_rig(path: Path) -> OpenFile:
    """Open a rig file as a take at rest."""
    record_input(path)
    rig = Rig.load(path)
    file = OpenFile(path, unit_name(rig.meters_per_unit), rig.up)
    file.notices += rig.notices
    file.takes.append(take_of_stream(rig.name, rest_take(rig)))
    return file


def _open_targets(path: Path, *, is_only_file: bool) -> OpenFile:
    """Open a targets file, with a notice if no rig is shown with it."""
    record_input(path)
    file = OpenFile(path, targets=load_targets(path))
    assert file.targets is not None
    file.notices += file.targets.notices
    if is_only_file:
        message = (
            "targets are shown without a rig: in metres, Y up, joints at the origin"
        )
        hint = f"animtool preview RIG {path.name} shows them with it"
        file.notices.append(
            Fault("PRV107", message, str(path), (), hint, Severity.NOTE)
        )
    return file


def _open_markers(path: Path, source_options: SourceOptions) -> OpenFile:
    """Open a file of markers and rotate it to Y up."""
    markers = open_markers(
        path, unit=source_options.unit, up=source_options.up, fps=source_options.fps
    )
    file = OpenFile(path, "m", markers.up, markers=markers)
    file.notices += markers.notices
    return file


def _open_stage(path: Path, file_name: str, source_options: SourceOptions) -> OpenFile:
    """Open a USD file with its characters and its other visible prims."""
    from animtool.usd.caches.shown import open_contents
    from animtool.usd.rigs.mesh_read import read_source_meshes

    contents = open_contents(path, source_options.prim_path)
    file = OpenFile(path, contents.unit, contents.up, contents=contents)
    characters = open_characters(path)
    root_path = source_options.prim_path
    selected_skeletons = [
        prim
        for prim in characters
        if root_path is None or f"{prim}/".startswith(f"{root_path.rstrip('/')}/")
    ]
    if len(selected_skeletons) <= 1 and (selected_skeletons or contents.is_animation()):
        stream_by_prim = {
            selected_skeletons[0] if selected_skeletons else "": open_source(
                path, source_options
            )
        }
        if source_options.take is None:
            file.notices += _other_takes(path, next(iter(stream_by_prim.values())))
    else:
        stream_by_prim = _read_characters(
            file, {p: characters[p] for p in selected_skeletons}
        )
    for prim, stream in stream_by_prim.items():
        label = source_stem(Path(file_name)) if len(stream_by_prim) == 1 else prim
        stream_y_up = reorient(stream, UpAxis.Y)
        if not prim:
            file.takes.append(
                TakeToShow(label, stream_y_up, bind_matrices(stream_y_up.rig))
            )
            continue
        meshes = read_source_meshes(path, prim)
        file.notices += meshes.notices
        bind = meshes.bind if len(meshes.bind) else bind_matrices(stream_y_up.rig)
        bones = contents.bone_names
        visible_surfaces = [
            surface for surface in meshes.surfaces if surface.name not in bones
        ]
        surfaces = rotate_unskinned(visible_surfaces, contents.up_rotation)
        colors = contents.bound_colors(prim)
        file.takes.append(
            TakeToShow(
                label,
                stream_y_up,
                bind,
                surfaces,
                meshes.strands,
                prim=prim,
                colors=colors,
            )
        )
    return file


def _read_characters(
    file: OpenFile, reader_by_prim: Mapping[str, Callable[[], TakeStream]]
) -> dict[str, TakeStream]:
    """Return the takes of all valid characters; report malformed characters."""
    stream_by_prim: dict[str, TakeStream] = {}
    format_errors: list[FormatError] = []
    for prim, read_stream in reader_by_prim.items():
        try:
            stream_by_prim[prim] = read_stream()
        except FormatError as error:
            format_errors.append(error)
    if format_errors and not stream_by_prim:
        raise format_errors[0]
    faults = [fault for error in format_errors for fault in error.faults]
    file.notices += [replace(f, severity=Severity.WARNING) for f in faults]
    return stream_by_prim


def _other_takes(path: Path, stream: TakeStream) -> list[Fault]:
    """Return a notice about the takes of a clip library that are not shown."""
    take_names = stream.details.get("takes")
    if not isinstance(take_names, list) or len(take_names) < 2:
        return []
    shown_name = stream.details.get("take")
    message = f"showing take {shown_name!r} of {counted(len(take_names), 'take')}"
    hint = f"show another with {argument('source.take')}: {listed(take_names)}"
    return [Fault("PRV101", message, str(path), (), hint, Severity.NOTE)]


def scene_to_show(scene: Scene) -> Scene:
    """Return a scene whose single output is baked for the page, not to its file."""
    output = scene.outputs[0]
    bake = replace(output.bake, form=None, chunk=None, overwrite=False, take=None)
    return replace(scene, outputs=(replace(output, path=None, bake=bake),))


def _combined_stage(
    folder: Path,
    layer_path: Path,
    options: PreviewOptions,
    weaker_layers: Sequence[Path] = (),
) -> Path:
    """Write a stage of a layer over weaker layers, under overlays; return its path."""
    from animtool.usd.layers.view import write_view

    overlays = [Path(layer) for layer in options.over]
    return write_view(folder / "view.usda", layer_path, weaker_layers, overlays)


def _open_scene(path: Path, options: PreviewOptions, context: ExitStack) -> OpenFile:
    """Bake a scene to a temporary layer, and open the layer."""
    from animtool.scene.bake.bake import bake_outputs
    from animtool.scene.file.read import load_scene

    scene = load_scene(path, dict(options.variables))
    if scene.extra_outputs:
        output_names = sorted(
            {extra_output.name for extra_output in scene.extra_outputs}
        )
        message = f"saves {', '.join(output_names)}"
        hint = "bake it, and preview its output"
        raise OptionError(Fault("PRV004", message, str(path), (), hint))
    output = scene_to_show(scene).outputs[0]
    bake = output.bake
    folder = Path(context.enter_context(tempfile.TemporaryDirectory("animtool")))
    layer_path = folder / f"{source_stem(path)}.usdc"
    joints_layer_path = folder / "bones" / layer_path.name
    outputs = [replace(output, path=layer_path, bake=bake)]
    if bake.deform and scene.sources:
        joints_layer_path.parent.mkdir()
        joints_bake = replace(bake, deform=False)
        outputs.append(
            replace(output, path=joints_layer_path, bake=joints_bake, systems=())
        )
    reports = bake_outputs(replace(scene, outputs=tuple(outputs)))
    stage_path = layer_path
    if bake.rig_layer is not None or options.over:
        rig_layers = [] if bake.rig_layer is None else [bake.rig_layer]
        stage_path = _combined_stage(folder, layer_path, options, rig_layers)
    file = _open_stage(stage_path, path.name, SourceOptions())
    file.path, file.folder = path, folder
    if len(outputs) > 1:
        # Meshes are shown as point caches, since their skeleton is in a separate layer.
        joint_takes = _open_stage(joints_layer_path, path.name, SourceOptions()).takes
        file.takes += [
            replace(take, surfaces=(), strands=(), prim="") for take in joint_takes
        ]
    file.notices += reports[0].notices
    return file
