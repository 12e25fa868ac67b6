"""Conversion of a rig between file formats."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from animtool.core.arguments import argument, flag
from animtool.core.errors import (
    AnimtoolError,
    Fault,
    OptionError,
    Severity,
    refuse_warnings,
)
from animtool.core.files.output import (
    atomic_outputs,
    check_outputs,
    protect_inputs,
    write_arrays,
    write_parts,
)
from animtool.core.files.reading import recorded_inputs
from animtool.core.names import has_kind_suffix, kind_suffixes
from animtool.core.record import dataclass
from animtool.core.writers import rig_writer
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import StoredArrays, with_array_file
from animtool.rig.write import rig_text
from animtool.scene.sources.onto_rig import open_rig


@dataclass(frozen=True, slots=True)
class RigReport:
    """Report of a rig conversion: its files, and counts of the rig's parts."""

    outputs: list[Path]  # the files written
    joints: int  # joints of the rig
    meshes: int
    shapes: int  # its blend shapes
    controls: int
    physics: int | None  # number of joint prims written; None if not requested
    notices: list[Fault]  # warnings and notes
    json_keys: ClassVar[str] = (
        "'convert' outputs joints meshes shapes controls physics notices"
    )

    @property
    def counts(self) -> dict[str, int]:
        """Number of joints, meshes, shapes and controls, by noun."""
        return {
            "joint": self.joints,
            "mesh/meshes": self.meshes,
            "shape": self.shapes,
            "control": self.controls,
        }


def convert_rig(
    source: Path | str,
    output: Path | str,
    *,
    prim_path: str | None = None,
    physics: bool = False,
    overwrite: bool = False,
    strict: bool = False,
) -> RigReport:
    """Convert a rig to a USD rig layer, or to a rig file and its arrays.

    Args:
        source: A file that contains a rig, such as a rig file or a USD file.
        output: ``.rig.yaml``, ``.usd``, ``.usda`` or ``.usdc``.
        prim_path: Path of the character, if a stage has several.
        physics: For USD: write joint types and limits to a separate layer.
        overwrite: Replace files that exist.
        strict: Treat warnings as errors.
    """
    job = RigJob(Path(source), Path(output), prim_path, physics, overwrite, strict)
    with atomic_outputs():
        report: RigReport = rig_writer(job.output)(job)
    return report


@dataclass(frozen=True, slots=True)
class RigJob:
    """Arguments of `convert_rig`, which it passes to the writer of the rig format."""

    source: Path
    output: Path
    prim_path: str | None
    physics: bool
    overwrite: bool
    strict: bool


def rig_outputs(output: Path, *, physics: bool = False) -> list[Path]:
    """Return the files of a rig in the format of an output, the main file first.

    Arrays of a rig file are not included, since some rigs have none.
    """
    files = [output, output.with_name(f"{output.stem}.physics.usda")]
    return files if physics else files[:1]


def _rig_report(
    rig: Rig,
    outputs: list[Path],
    notices: list[Fault],
    physics_prim_count: int | None = None,
) -> RigReport:
    counts = len(rig.joints), len(rig.meshes), len(rig.shapes), len(rig.controls)
    return RigReport(outputs, *counts, physics_prim_count, notices)


def rig_to_file(job: RigJob) -> RigReport:
    """Read a rig of any format, and write a rig file and its arrays."""
    if job.physics:
        message = f"{argument('physics')} needs a USD file as output"
        raise OptionError(Fault("CLI004", message, str(job.output)))
    with recorded_inputs() as inputs:
        rig, notices = open_rig(job.source, job.prim_path)
    file = rig_file(rig, job.output, job.source)
    read_files = [job.source, *inputs.opened_paths]
    check_outputs(file.outputs, read_files, overwrite=job.overwrite)
    refuse_warnings(notices, strict=job.strict)
    file.write()
    return _rig_report(file.rig, file.outputs, notices)


@dataclass(frozen=True, slots=True)
class RigFile:
    """A rig in the form of a rig file, ready to write."""

    rig: Rig
    arrays: StoredArrays  # arrays stored next to the file
    outputs: list[Path]  # output files, the rig file last

    def write(self) -> None:
        """Write the rig and its arrays, each atomically."""
        if self.arrays:
            write_arrays(self.outputs[0], self.arrays)
        write_parts(self.outputs[-1], [rig_text(self.rig).encode()])


def rig_file(rig: Rig, output: Path, source: Path) -> RigFile:
    """Return the rig file of a rig that was read from another format."""
    stem_of_name = output.name
    for suffix in kind_suffixes("rig"):
        stem_of_name = stem_of_name.removesuffix(suffix)
    arrays_path = output.with_name(f"{stem_of_name}.npz")
    is_other_folder = source.resolve().parent != output.resolve().parent
    rig, arrays = with_array_file(rig, arrays_path, copies_all=is_other_folder)
    return RigFile(rig, arrays, [arrays_path, output] if arrays else [output])


def _ignored_motion_notice(
    source: Path, output: Path, prim_path: str | None
) -> list[Fault]:
    """Return a note that the motion of a source is not converted."""
    if has_kind_suffix(source, "rig"):
        return []
    from animtool.scene.sources.open import SourceOptions, open_source

    try:
        stream = open_source(source, SourceOptions(prim_path=prim_path))
        frames = sum(block.frames for block in stream.blocks)
    except AnimtoolError:
        # A rig without animation; its other faults were reported with the rig.
        return []
    if frames < 2:
        return []
    message = f"only the rig is written, without its motion of {frames} frames"
    rig_layer = flag("rig-layer", output.name)
    hint = f"animtool bake {source.name} {rig_layer} -o MOTION.usda"
    return [Fault("CLI104", message, str(source), (), hint, Severity.NOTE)]


def rig_to_usd(job: RigJob) -> RigReport:
    """Write a rig layer and, if requested, its physics layer."""
    output, outputs = job.output, rig_outputs(job.output, physics=job.physics)
    check_outputs(outputs, [job.source], overwrite=job.overwrite)
    with protect_inputs(outputs):
        rig, notices = open_rig(job.source, job.prim_path)
    notices = notices + _ignored_motion_notice(job.source, output, job.prim_path)
    from animtool.usd.rigs.layer import write_physics_layer, write_rig_layer

    refuse_warnings(notices, strict=job.strict)
    _, layer_notices = write_rig_layer(rig, output)
    joint_prim_count = None
    if job.physics:
        _, joint_prim_count = write_physics_layer(rig, outputs[1], output)
    return _rig_report(rig, outputs, notices + layer_notices, joint_prim_count)
