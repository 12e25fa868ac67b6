"""A rig alone as USD: the layer that other departments refer to."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from animtool.errors import Fault
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.usd.layers import attribute, new_layer, prim, relationship, save_layer
from animtool.usd.meshes import author_meshes
from animtool.usd.names import joint_names, legal_name
from animtool.usd.paths import RigPaths
from animtool.usd.physics import author_physics
from animtool.usd.skeleton import author_rig

# What USD takes where a layer says nothing; an animation over the rig adopts it.
RATE = Fraction(24)


def write_rig_layer(rig: Rig, path: Path) -> tuple[int, list[Fault]]:
    """Write a rig layer; return its size in bytes and what is odd about names.

    It holds the model, the SkelRoot, the Skeleton with bind and rest, the meshes and
    blend shapes, and in customData what USD has no place for. It binds no animation.

    Raises:
        FormatError: An array of the rig cannot be read.
        OutputError: It cannot be written.
    """
    layer, names = _rig_layer(rig, path)
    return save_layer(layer, path), names


def _rig_layer(rig: Rig, path: Path) -> tuple[Any, list[Fault]]:
    names = joint_names(rig.joints)
    paths = RigPaths.below(f"/{legal_name(rig.name)}")
    layer, meters = new_layer(path), rig.meters_per_unit
    with Sdf.ChangeBlock():
        _metadata(layer, rig, paths)
        author_rig(layer, rig, names, paths, meters)
        tokens = dict(zip(rig.names, rig.paths(names.names), strict=True))
        _, said = author_meshes(layer, surfaces_of(rig), paths, tokens, meters)
        root = layer.GetPrimAtPath(paths.root)
        schemas = Sdf.TokenListOp()
        schemas.prependedItems = ["SkelBindingAPI"]
        root.SetInfo("apiSchemas", schemas)
        relationship(root, "skel:skeleton", paths.skeleton)
    stage = Usd.Stage.Open(layer)
    made = UsdGeom.Boundable(stage.GetPrimAtPath(paths.root))
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(made, Usd.TimeCode.Default())
    bounds = np.array(extent, np.float32).reshape(-1, 3)
    with Sdf.ChangeBlock():
        value = Vt.Vec3fArray.FromNumpy(bounds)
        attribute(root, "extent", Sdf.ValueTypeNames.Float3Array, value)
    notices = [replace(fault, path=str(path)) for fault in names.notices + said]
    return layer, notices


def _metadata(layer: Any, rig: Rig, paths: RigPaths) -> None:
    layer.defaultPrim = Sdf.Path(paths.model).name
    layer.framesPerSecond = layer.timeCodesPerSecond = float(RATE)
    layer.pseudoRoot.SetInfo("metersPerUnit", rig.meters_per_unit)
    layer.pseudoRoot.SetInfo("upAxis", rig.up.value)


def write_physics_layer(rig: Rig, path: Path, rig_path: Path) -> tuple[int, int]:
    """Write joints as UsdPhysics has them, over a rig layer.

    Args:
        rig: The rig of that layer.
        path: The file.
        rig_path: The rig layer, beside it.

    Returns:
        Bytes, and how many joints.

    Raises:
        OutputError: It cannot be written.
    """
    layer = new_layer(path)
    paths = RigPaths.below(f"/{legal_name(rig.name)}")
    names = joint_names(rig.joints).names
    with Sdf.ChangeBlock():
        _metadata(layer, rig, paths)
        layer.pseudoRoot.SetInfo("kilogramsPerUnit", 1.0)
        prim(layer, paths.model, over=True)
        made = author_physics(layer, paths.model, rig, names, rig.meters_per_unit)
    layer.subLayerPaths = [f"./{rig_path.name}"]
    return save_layer(layer, path), made
