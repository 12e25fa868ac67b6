"""Writes prims that move rigidly: props of a take, and instances of meshes.

Each prop, camera or light is a prim. Instances are a PointInstancer or named Xforms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf

from animtool.core.array_types import BoolArray, Float32Array, FloatArray
from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.motion.frames import MeshFrame, TransformsFrame
from animtool.motion.motion import Motion
from animtool.motion.transforms import Track, Transforms
from animtool.usd.caches.writer import (
    ATTRIBUTE_KINDS,
    AttributeKind,
    FrameEncoder,
    FramePrimWriter,
    author_values,
    bounds,
    bounds_corners,
)
from animtool.usd.layers.names import RigPaths, UsdNames, distinct_names
from animtool.usd.layers.sdf import (
    SampleWriter,
    asset_path,
    attribute_spec,
    author_relationship,
    author_xform_order,
    gf_quaternion,
    gf_vec3f,
    gf_vector,
    prim_spec,
)
from animtool.usd.props.placement import PropPlacements, is_same_or_below


@dataclass(slots=True)
class PropSamples:
    """Prop tracks of a take sampled for a layer."""

    tracks: tuple[Track, ...]
    # Time codes of the recorded frames, one array per block.
    codes: list[FloatArray] = field(default_factory=list)
    # Time of each track at these frames ``(F, N)``, one array per block.
    track_times: list[FloatArray] = field(default_factory=list)

    def record(self, codes: FloatArray, motion: Motion) -> None:
        """Record the time codes and track times of a block."""
        assert motion.track_times is not None
        self.codes.append(codes)
        self.track_times.append(motion.track_times.dense()[..., 0])


# Converts a row of values to a USD value.
_ConvertRow: TypeAlias = Callable[[Any], Any]


def prop_paths(tracks: Sequence[Track], model: str) -> list[str]:
    """Return the stage paths of tracks; relative ones begin at the path ``model``."""
    return [
        track.path if track.path.startswith("/") else f"{model}/{track.path}"
        for track in tracks
    ]


def check_props(
    tracks: Sequence[Track], paths: RigPaths, stage: Any = None, *, is_library: bool
) -> None:
    """Refuse prop paths that overlap the character or each other.

    ``stage`` is that of the rig below the layer, if any. ``is_library`` says whether
    takes are variants of the model.
    """
    faults = []
    model, root = paths.model, paths.root
    prim_paths = prop_paths(tracks, model)
    for i, (track, path) in enumerate(zip(tracks, prim_paths, strict=True)):
        existing_prim = None if stage is None else stage.GetPrimAtPath(path)
        message, hint = "", "choose another path, such as Props/box"
        if paths_overlap(path, root) or is_same_or_below(model, path):
            message = f"{path} is part of the character at {model}"
        elif existing_prim and existing_prim.IsInstanceProxy():
            message = f"{path} is inside an instance, which a layer cannot reach"
        elif is_library and not is_same_or_below(path, model):
            message = f"{path} is not below {model}, whose variants are the takes"
        if message:
            faults.append(Fault("SCN047", message, hint=hint, where=track.path))
        for other_path in prim_paths[:i]:
            if paths_overlap(path, other_path):
                message = f"{path} overlaps {other_path}, which another prop has"
                hint = "each needs its own path, not below another's"
                faults.append(Fault("SCN046", message, hint=hint, where=track.path))
    if faults:
        raise OptionError(faults)


def paths_overlap(first_path: str, second_path: str) -> bool:
    """Return whether one path contains the other."""
    return is_same_or_below(first_path, second_path) or is_same_or_below(
        second_path, first_path
    )


def author_props(
    layer: Any,
    samples: PropSamples,
    placements: PropPlacements,
    output: Path,
) -> tuple[list[str], list[Fault]]:
    """Write the prims of prop tracks; constant values become defaults.

    ``output`` is the path of the file, or `STDOUT`.

    Returns the prim paths, and notices about their frames.
    """
    paths = prop_paths(samples.tracks, placements.model)
    codes, track_times = (
        np.concatenate(samples.codes),
        np.concatenate(samples.track_times),
    )
    notices: list[Fault] = []
    for i, (track, path) in enumerate(zip(samples.tracks, paths, strict=True)):
        _define_ancestors(layer, path, placements)
        is_existing = placements.has_prim(path)
        type_name = "" if is_existing else track.type_name
        spec = prim_spec(
            layer, placements.layer_path(path), type_name, is_over=is_existing
        )
        if track.reference is not None:
            name = asset_path(Path(track.reference.file), output.parent)
            prim_path = Sdf.Path(track.reference.prim or "")
            spec.referenceList.prependedItems.append(Sdf.Reference(name, prim_path))
        transforms = placements.to_parent_space(
            track, path, codes, track.at(track_times[:, i])
        )
        _author_track(spec, track, codes, transforms, placements.unit_at_path(path))
        if transforms.is_clamped is not None and transforms.is_clamped.any():
            notices.append(_clamped_notice(track, path, codes, transforms.is_clamped))
    return paths, notices


def _clamped_notice(
    track: Track, path: str, codes: FloatArray, is_clamped: BoolArray
) -> Fault:
    """Return a notice about frames outside a prop's range, where it is constant."""
    spans = [
        " to ".join(dict.fromkeys(f"{codes[i]:.10g}" for i in (first, end - 1)))
        for first, end in runs(is_clamped)
    ]
    message = (
        f"{path} is constant at frames {', '.join(spans)}: its file has none there"
    )
    hint = (
        "write `frame:` with the first frame of its file" if is_clamped.all() else None
    )
    return track.note("SCN107", message, hint=hint, severity=Severity.WARNING)


def _define_ancestors(layer: Any, path: str, placements: PropPlacements) -> None:
    """Define the ancestor prims that no other layer defines."""
    for ancestor in list(Sdf.Path(path).GetAncestorsRange())[1:]:
        ancestor_path = str(ancestor)
        if ancestor.IsAbsoluteRootPath() or is_same_or_below(
            placements.model, ancestor_path
        ):
            continue
        layer_path = placements.layer_path(ancestor_path)
        if layer.GetPrimAtPath(layer_path) is None and not placements.has_prim(
            ancestor_path
        ):
            prim_spec(layer, layer_path, "Xform")


def _author_track(
    spec: Any, track: Track, codes: FloatArray, transforms: Transforms, unit: float
) -> None:
    types = Sdf.ValueTypeNames
    # Points of a referenced file are in that file's unit.
    reference_scale = (
        1.0 if track.reference is None else track.reference.meters_per_unit / unit
    )

    def author(name: str, type_name: Any, rows: Any, convert: _ConvertRow) -> None:
        are_quaternions = type_name == types.Quatd
        attr = attribute_spec(spec, name, type_name)
        samples = SampleWriter(attr, convert, are_quaternions=are_quaternions)
        samples.add(codes, rows)
        samples.finish(rows[0])

    if transforms.matrices is not None:
        matrices = transforms.matrices.copy()
        matrices[:, :3, 3] /= unit
        matrices[:, :3, :3] *= reference_scale
        rows = matrices.swapaxes(1, 2)
        author(
            "xformOp:transform",
            types.Matrix4d,
            rows,
            lambda row: Gf.Matrix4d(row.tolist()),
        )
        author_xform_order(spec, "xformOp:transform")
    elif track.has_transform:
        author(
            "xformOp:translate",
            types.Double3,
            transforms.translations / unit,
            gf_vector,
        )
        author("xformOp:orient", types.Quatd, transforms.rotations, gf_quaternion)
        author(
            "xformOp:scale",
            types.Double3,
            transforms.scales * reference_scale,
            gf_vector,
        )
        author_xform_order(spec, "xformOp:translate", "xformOp:orient", "xformOp:scale")
    for attribute, values in zip(track.attributes, transforms.values, strict=True):
        value_type = types.Find(attribute.type_name)
        if not attribute.width:
            author(attribute.name, value_type, values, attribute.choices.__getitem__)
            continue
        rows = values / (unit if attribute.is_length else 1.0)
        author(
            attribute.name,
            value_type,
            rows,
            lambda row: float(row[0]) if len(row) == 1 else tuple(row.tolist()),
        )


# Operations of an animated Xform.
_XFORM_OPS = ("xformOp:translate", "xformOp:orient")
PROTOTYPES_NAME, PHYSICS_NAME = (
    "Prototypes",
    "Physics",
)  # child prims that are not instances


class InstancerEncoder(FrameEncoder[TransformsFrame]):
    """Instances written as a PointInstancer."""

    type_name = "PointInstancer"
    sampled_names = (
        "positions",
        "velocities",
        "ids",
        "orientationsf",
        "angularVelocities",
        "scales",
        "protoIndices",
    )
    points = "positions"

    def author_constants(
        self, writer: FramePrimWriter, spec: Any, frame: TransformsFrame
    ) -> None:
        """Write the prototype meshes below the prim."""
        author_relationship(
            spec, "prototypes", *_write_prototypes(writer, spec, frame.meshes)
        )

    def values(
        self,
        writer: FramePrimWriter,
        frame: TransformsFrame,
        points: Float32Array,
        code: float,
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return ids, orientations, spins, scales, prototype indices and extent."""
        box_corners = np.stack([bounds_corners(mesh.points) for mesh in frame.meshes])
        corners = box_corners[frame.mesh_indices] * (
            frame.scales[:, None] / writer.unit
        )
        corners = so3.rotate(frame.rotations[:, None], corners) + points[:, None]
        extent = writer.to_float32("extent", corners.reshape(-1, 3), code)
        return {
            "ids": frame.ids,
            "orientationsf": writer.to_float32("orientationsf", frame.rotations, code),
            "angularVelocities": writer.to_float32(
                "angularVelocities", np.degrees(frame.spins), code
            ),
            "scales": writer.to_float32("scales", frame.scales, code),
            "protoIndices": frame.mesh_indices.astype(np.int32),
            "extent": bounds(extent, 0.0),
        }


class XformsEncoder(FrameEncoder[TransformsFrame]):
    """Named instances: an Xform each, whose mesh references a prototype."""

    type_name = "Xform"
    points = ""

    def attribute_kinds(self, frame: TransformsFrame) -> dict[str, AttributeKind]:
        """Return the transform ops of the animated instances."""
        return {
            f"{instance_name}.{name}": ATTRIBUTE_KINDS[name]
            for i, instance_name in enumerate(instance_names(frame.names).names)
            if i not in frame.static
            for name in _XFORM_OPS
        }

    def author_children(self, spec: Any, frame: TransformsFrame) -> None:
        """Create the Xforms, in order."""
        for name in instance_names(frame.names).names:
            prim_spec(spec.layer, f"{spec.path}/{name}", "Xform")

    def author_constants(
        self, writer: FramePrimWriter, spec: Any, frame: TransformsFrame
    ) -> None:
        """Write meshes, xformOpOrder, and transforms of static instances.

        The prototypes are class prims, so that they are not drawn.
        """
        layer, paths = spec.layer, _write_prototypes(writer, spec, frame.meshes)
        layer.GetPrimAtPath(
            f"{spec.path}/{PROTOTYPES_NAME}"
        ).specifier = Sdf.SpecifierClass
        for i, name in enumerate(writer.child_names):
            instance = layer.GetPrimAtPath(f"{spec.path}/{name}")
            names = list(_XFORM_OPS)
            if i in frame.static:
                transform = _instance_transform(frame, i, writer.unit)
                author_values(instance, dict(zip(names, transform, strict=True)))
            if not (frame.scales[i] == 1.0).all():
                scale = gf_vec3f(frame.scales[i])
                attribute_spec(
                    instance, "xformOp:scale", Sdf.ValueTypeNames.Float3, scale
                )
                names.append("xformOp:scale")
            author_xform_order(instance, *names)
            mesh = prim_spec(layer, f"{instance.path}/mesh")
            mesh.referenceList.Prepend(Sdf.Reference("", paths[frame.mesh_indices[i]]))
        if frame.physics is not None:
            from animtool.usd.physics.write import PhysicsWriter

            PhysicsWriter(
                spec, writer.child_names, frame.physics, writer.unit, writer.rotation
            ).write()

    def values(
        self,
        writer: FramePrimWriter,
        frame: TransformsFrame,
        points: Float32Array,  # noqa: ARG002
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return the transforms of the animated instances."""
        return {
            f"{instance_name}.{name}": value
            for i, instance_name in enumerate(writer.child_names)
            if i not in frame.static
            for name, value in zip(
                _XFORM_OPS, _instance_transform(frame, i, writer.unit), strict=True
            )
        }


def _instance_transform(
    frame: TransformsFrame, i: int, unit: float
) -> tuple[FloatArray, FloatArray]:
    """Return an instance's translation, in units of ``unit`` [m], and its rotation."""
    return frame.points[i] / unit, frame.rotations[i]


def instance_names(names: Sequence[str]) -> UsdNames:
    """Return legal, unique names of instances.

    >>> instance_names(["brick[3]", "brick_3"]).names
    ['brick_3', 'brick_3_2']
    """
    all_names = [PROTOTYPES_NAME, PHYSICS_NAME, *names]
    unique_names = distinct_names(
        all_names, [name.removesuffix("]") for name in all_names], all_names
    )
    return replace(unique_names, names=unique_names.names[2:])


def _write_prototypes(
    writer: FramePrimWriter, spec: Any, meshes: Sequence[MeshFrame]
) -> list[str]:
    """Write prototype meshes below a prim; return their paths."""
    scope = prim_spec(spec.layer, f"{spec.path}/{PROTOTYPES_NAME}", "Scope")
    paths = [f"{scope.path}/mesh_{i + 1}" for i in range(len(meshes))]
    for path, mesh in zip(paths, meshes, strict=True):
        writer.write_static(spec.layer, path, mesh)
    return paths
