"""USD layers, text and crate, read as info, convert, bake and validate read them."""

from __future__ import annotations

import gc
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf
from support.broken_usd import write_good
from support.clean_layer import make_layer

from animtool.core.errors import AnimtoolError
from animtool.core.values import plain_value
from animtool.motion.take import TakeStream
from animtool.report.describe import describe
from animtool.scene.sources.open import SourceOptions
from animtool.usd.caches.info import describe_points
from animtool.usd.checks.run import inspect_layer
from animtool.usd.layers.sdf import forget_layers, limit_usd_threads
from animtool.usd.rigs.mesh_read import read_source_meshes
from animtool.usd.rigs.stored import read_rig_with_data
from animtool.usd.rigs.target import open_target
from animtool.usd.takes.read import read_usd
from fuzz.mutations import pick, spoil

ABOUT = "USD layers, text and crate, read by every reader"

TOKEN = re.compile(rb'[\w.+-]+|"[^"\n]*"|<[^>\n]*>|@[^@\n]*@|[()\[\]{},=]')
ODD = [
    *(b"nan", b"-inf", b"inf", b"1e39", b"1e308", b"-1", b"0", b"99999999", b"None"),
    *(b"[]", b"[1]", b"(1, 2)", b'""', b'"x"', b"</>", b"</pair>", b"<../..>", b"@@"),
    *(b"@./take.usda@", b"float", b"int[]", b"token[]", b"matrix4d[]", b"string"),
    *(b"quatf[]", b"double3", b"half3[]", b"def", b"over", b"class", b"uniform"),
    *(b".timeSamples", b"references = @./take.usda@", b"inherits = </pair/Rig>"),
]


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    limit_usd_threads()
    seeds = [write_good(folder), make_layer(folder / "clean.usda")]
    small = make_layer(folder / "small.usda", 3, mesh=False)
    crates = []
    for path in (*seeds, small):
        Sdf.Layer.FindOrOpen(str(path)).Export(str(folder / "crate.usdc"))
        crates.append((folder / "crate.usdc").read_bytes())
    layers = [Sdf.Layer.OpenAsAnonymous(str(path)) for path in (*seeds, small)]
    texts = [path.read_bytes() for path in (*seeds, small)]
    gc.freeze()

    def run(rng: np.random.Generator) -> str:
        kind = rng.random()
        path = folder / ("take.usdc" if kind < 0.2 else "take.usda")
        if kind < 0.2:
            path.write_bytes(spoil(rng, pick(rng, crates)))
        elif kind < 0.3:
            path.write_bytes(spoil(rng, pick(rng, texts)))
        elif kind < 0.5:
            path.write_bytes(_retold(rng, pick(rng, texts)))
        else:
            path.write_text(_changed(rng, layers[rng.integers(len(layers))]))
        reader = READERS[rng.integers(len(READERS))]
        try:
            return reader(path)
        except AnimtoolError as error:
            return error.code
        finally:
            forget_layers()

    return run


def _retold(rng: np.random.Generator, data: bytes) -> bytes:
    """Return text with some words replaced by others, of its own or odd ones."""
    found = list(TOKEN.finditer(data))
    for _ in range(int(min(rng.geometric(0.4), 6))):
        token = found[rng.integers(len(found))]
        other = found[rng.integers(len(found))].group()
        if rng.random() < 0.7:
            other = ODD[rng.integers(len(ODD))]
        data = data[: token.start()] + other + data[token.end() :]
        found = [one for one in found if one.end() < token.start()] or found
    return data


def _changed(rng: np.random.Generator, good: Sdf.Layer) -> str:
    """Return a layer as text that USD can read, with odd values, types and arcs."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(good)
    specs: list[Sdf.Spec] = []
    layer.Traverse(
        Sdf.Path.absoluteRootPath,
        lambda path: specs.append(layer.GetObjectAtPath(path)),
    )
    for _ in range(int(min(rng.geometric(0.4), 5))):
        spec = specs[rng.integers(len(specs))]
        # What one change makes impossible, USD refuses.
        with suppress(Tf.ErrorException, TypeError, ValueError, AttributeError):
            _change(rng, layer, spec)
    return layer.ExportToString()


def _change(rng: np.random.Generator, layer: Sdf.Layer, spec: Sdf.Spec) -> None:
    if isinstance(spec, Sdf.AttributeSpec):
        kind = rng.integers(4)
        if kind == 0:
            _retype(rng, spec)
        elif kind == 1 and layer.GetNumTimeSamplesForPath(spec.path):
            codes = layer.ListTimeSamplesForPath(spec.path)
            code = codes[rng.integers(len(codes))]
            value = layer.QueryTimeSample(spec.path, code)
            moved = code if rng.integers(3) else float(rng.choice(NUMBERS))
            layer.SetTimeSample(spec.path, moved, _odd(rng, value))
        elif kind == 2:
            layer.EraseTimeSample(spec.path, 1.0)
            spec.ClearDefaultValue()
        else:
            spec.default = _odd(rng, spec.default)
    elif isinstance(spec, Sdf.RelationshipSpec):
        spec.targetPathList.explicitItems = [PATHS[rng.integers(len(PATHS))]]
    elif isinstance(spec, Sdf.PrimSpec):
        _compose(rng, spec)
    else:
        name = str(rng.choice(["startTimeCode", "timeCodesPerSecond", "endTimeCode"]))
        layer.pseudoRoot.SetInfo(name, float(rng.choice(NUMBERS)))


def _compose(rng: np.random.Generator, spec: Sdf.PrimSpec) -> None:
    """Give a prim an arc, another type or data of a wrong type."""
    path = PATHS[rng.integers(len(PATHS))]
    kind = rng.integers(6)
    if kind == 0:
        spec.referenceList.Append(Sdf.Reference("", path))
    elif kind == 1:
        spec.inheritPathList.Append(path)
    elif kind == 2:
        spec.typeName = str(rng.choice(["", "Mesh", "Skeleton", "SkelRoot", "Xyz"]))
    elif kind == 3:
        spec.specifier = Sdf.SpecifierClass
    elif kind == 4:
        own = dict(spec.customData.get("animtool", {}))
        for key in own:
            if rng.integers(2):
                own[key] = [7, "x", {"y": 1}, 1.5, ""][rng.integers(5)]
        spec.customData["animtool"] = own if rng.integers(4) else "x"
    else:
        spec.SetInfo("active", False)


NUMBERS = [np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1e-300, 4e9, 7.25]
PATHS = [
    Sdf.Path(text) for text in ("/pair/Rig", "/pair", "/Hero/Rig/Skel", "/no", "/")
]


def _odd(rng: np.random.Generator, value: Any) -> Any:
    """Return a value of the same type with another length, or odd numbers in it."""
    number = float(rng.choice(NUMBERS))
    if isinstance(value, float):
        return number
    if isinstance(value, int):
        return int(rng.choice([-1, 0, 2**31 - 1, 7]))
    if isinstance(value, str):
        return str(rng.choice(["", "odd", "x/y", "..", "hips"]))
    rows = list(value)
    kind = rng.integers(3)
    if kind == 0:
        rows = rows[: rng.integers(len(rows) + 1)]
    elif kind == 1:
        rows = rows * 2
    elif rows:
        rows[rng.integers(len(rows))] = _odd(rng, rows[0])
    return type(value)(rows)


def _retype(rng: np.random.Generator, spec: Sdf.AttributeSpec) -> None:
    """Give an attribute another type, without a value or with one of that."""
    layer, prim, name = spec.layer, spec.owner, spec.name
    types = [Sdf.ValueTypeNames.Find(word) for word in TYPES]
    kind = types[rng.integers(len(types))]
    layer.GetPrimAtPath(prim.path).RemoveProperty(spec)
    made = Sdf.AttributeSpec(prim, name, kind)
    if kind.isArray and rng.integers(4):
        made.default = type(kind.defaultValue)(int(rng.integers(8)))
    elif rng.integers(4):
        made.default = kind.defaultValue


TYPES = ["float", "int[]", "token[]", "string", "matrix4d[]", "float3[]", "double"]


def _read(path: Path) -> str:
    take = read_usd(path)
    _check_finite(take)
    return "read"


def _check_finite(stream: TakeStream) -> None:
    for block in stream.blocks:
        channels = (block.translations, block.rotations, block.scales, block.weights)
        for channel in filter(None, channels):
            assert np.isfinite(channel.rest).all()
            assert np.isfinite(channel.values).all()
    rig = stream.rig
    assert np.isfinite(rig.rest_translations).all()
    assert np.isfinite(rig.rest_rotations).all()


def _described(path: Path) -> str:
    points = describe_points(path)
    if points is not None:
        plain_value(points)
        return "points"
    plain_value(describe(path, SourceOptions()))
    return "described"


def _checked(path: Path) -> str:
    return "findings" if inspect_layer(path).faults else "clean"


def _rig(path: Path) -> str:
    rig, _ = read_rig_with_data(path)
    assert np.isfinite(rig.rest_translations).all()
    return "rig"


def _meshes(path: Path) -> str:
    read_source_meshes(path, None)
    return "meshes"


def _target(path: Path) -> str:
    open_target(path, None)
    return "target"


READERS = [_read, _described, _checked, _rig, _meshes, _target]
