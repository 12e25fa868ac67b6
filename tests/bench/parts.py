"""The parts of `bvh_to_usd.py` that need numpy, USD and animtool.

Each is run as a process of its own, ``python parts.py PART ARGUMENTS``, so that the
process which measures stays small: on Linux a child's peak memory begins at that of
its parent. The result is printed as JSON.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from clock import Taken
from measuring import in_process, in_turn

Array = npt.NDArray[np.float64]

NOISE = 0.05
DECIMALS = 4
SEED = 20


def make_long(source: str, output: str, frames: str) -> dict[str, int]:
    """Write ``source`` looped to so many frames, every value with its own noise."""
    from animtool import _kernels

    head, rest = Path(source).read_text().split("Frame Time:")
    frame_time, rows = rest.split("\n", 1)
    values = np.array([row.split() for row in rows.splitlines() if row.strip()], float)
    total, width = int(frames), values.shape[1]
    decimals = np.full(width, DECIMALS, np.int64)
    rng = np.random.default_rng(SEED)
    head = re.sub(r"Frames:\s*\d+", f"Frames: {total}", head)
    with Path(output).open("wb") as file:
        file.write(f"{head}Frame Time:{frame_time}\n".encode())
        for start in range(0, total, len(values)):
            block = values[: total - start]
            block = block + rng.normal(0.0, NOISE, block.shape)
            file.write(_kernels.format_bvh_rows(block, decimals))
    return {"bytes": Path(output).stat().st_size}


class Reference:
    """World positions of a BVH's joints in float64, in the file's unit.

    Attributes:
        names: Of the joints, as USD may spell them.
        positions: Every nth frame ``(F, J, 3)``.
    """

    def __init__(self, source: str, every: int) -> None:
        from pxr import Tf

        import animtool
        from animtool.rig.kinematics import forward_kinematics

        take = animtool.read_bvh(source).collect()
        motion = take.motion.map(lambda c: c.select(slice(None, None, every)))
        translations = motion.translations.dense()
        world = forward_kinematics(take.rig, translations, motion.rotations.dense())
        self.names = [Tf.MakeValidIdentifier(name) for name in take.rig.names]
        self.positions = world.positions / take.rig.meters_per_unit
        self.meters_per_unit = take.rig.meters_per_unit

    def order(self, names: list[str]) -> list[int]:
        """Return where each of the joints stands in ``names``."""
        return [names.index(name) for name in self.names]

    def error(self, positions: Array) -> float:
        """Return the largest distance to positions ``(F, J, 3)`` [cm]."""
        distances = np.linalg.norm(positions - self.positions, axis=-1)
        return float(distances.max()) * self.meters_per_unit * 100


def _positions(path: str, codes: Array) -> tuple[list[str], Array]:
    """Return joint names and world positions ``(F, J, 3)`` as UsdSkel has them.

    A Skeleton needs a SkelRoot above it before UsdSkel binds an animation to it,
    which a file without meshes from Blender lacks; so the SkelAnimation is queried
    by itself and placed by the transforms above the Skeleton.
    """
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(path)
    prims = list(stage.Traverse())
    skeleton = next(p for p in prims if p.IsA(UsdSkel.Skeleton))
    animation = next(p for p in prims if p.IsA(UsdSkel.Animation))
    query = UsdSkel.Cache().GetAnimQuery(UsdSkel.Animation(animation))
    tokens = query.GetJointOrder()
    assert list(tokens) == list(UsdSkel.Skeleton(skeleton).GetJointsAttr().Get())
    topology = UsdSkel.Topology(tokens)
    placed = UsdGeom.Xformable(skeleton)
    world = np.empty((len(codes), len(tokens), 3))
    for i, code in enumerate(codes.tolist()):
        local = query.ComputeJointLocalTransforms(code)
        root = placed.ComputeLocalToWorldTransform(code)
        joints = UsdSkel.ConcatJointTransforms(topology, local, root)
        world[i] = np.asarray(joints)[:, 3, :3]
    return [str(token).rsplit("/", 1)[-1] for token in tokens], world


def _sampled_codes(path: str, every: int) -> Array:
    from pxr import Usd, UsdSkel

    stage = Usd.Stage.Open(path)
    prim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Animation))
    codes = UsdSkel.Animation(prim).GetRotationsAttr().GetTimeSamples()
    return np.array(codes[::every])


def errors(source: str, every: str, *outputs: str) -> dict[str, Any]:
    """Return the largest error of each output, ``tool=path`` [cm].

    Frame i of the BVH is the i-th sample of the file. The shift of frames that would
    fit better than none is reported as ``shift``; 0 where none would.
    """
    step = int(every)
    reference = Reference(source, step)
    found: dict[str, Any] = {}
    for output in outputs:
        tool, path = output.split("=", 1)
        if path.endswith(".npz"):
            stored = np.load(path)
            names, positions = stored["names"].tolist(), stored["positions"]
            found[tool] = {
                "error": reference.error(_ordered(reference, names, positions))
            }
        else:
            found[tool] = _usd_error(reference, path, step)
    return found


def _ordered(reference: Reference, names: list[str], positions: Array) -> Array:
    return positions[:, reference.order(names)]


def _usd_error(reference: Reference, path: str, every: int) -> dict[str, Any]:
    from pxr import Usd, UsdGeom

    codes = _sampled_codes(path, every)
    stage = Usd.Stage.Open(path)
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    up = UsdGeom.GetStageUpAxis(stage)
    assert len(codes) == len(reference.positions), (len(codes), path)

    def error(shift: float) -> float:
        names, world = _positions(path, codes + shift)
        if up == "Z":
            # The importer's own turn, (x, y, z) to (x, -z, y), taken back.
            world = world[..., [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
        return reference.error(_ordered(reference, names, world))

    by_shift = {shift: error(shift) for shift in (-1.0, 0.0, 1.0)}
    return {
        "error": by_shift[0.0],
        "shift": min(by_shift, key=lambda shift: by_shift[shift]),
        "first_code": float(codes[0]),
        "meters_per_unit": meters,
        "up": str(up),
    }


def kernel(source: str, work: str, megabytes: str, runs: str) -> dict[str, Any]:
    """Time the row parser and np.loadtxt on the first rows of a BVH file, in turn."""
    size = int(float(megabytes) * 1e6)
    rows = Path(work) / "rows.txt"
    with Path(source).open("rb") as file:
        for line in file:
            if line.startswith(b"Frame Time"):
                break
        text = file.read(size)
    text = text[: text.rindex(b"\n") + 1]
    rows.write_bytes(text)
    width = len(text.split(b"\n", 1)[0].split())
    parsed, loaded = parse_rows(rows, width), np.loadtxt(rows)
    assert (parsed == loaded).all()
    taken = timed_in_turn(
        {
            "parse_bvh_rows": lambda: parse_rows(rows, width),
            "np.loadtxt": lambda: np.loadtxt(rows),
        },
        int(runs),
    )
    return {"bytes": len(text), "taken": taken}


def timed_in_turn(
    works: dict[str, Callable[[], object]], runs: int
) -> dict[str, list[Taken]]:
    """Return what each work took, in turn."""
    return in_turn({name: in_process(work) for name, work in works.items()}, runs)


def parse_rows(path: Path, width: int) -> Array:
    """Parse rows as `animtool.formats.bvh.lines` does, blocks kept in one list."""
    from animtool import _kernels
    from animtool.formats.bvh.lines import BLOCK_VALUES, CHUNK_BYTES

    limit, blocks, text, starved = BLOCK_VALUES // width, [], b"", True
    with path.open("rb", buffering=0) as file:
        while True:
            final = False
            if starved:
                chunk = file.read(CHUNK_BYTES)
                final = not chunk
                text += chunk
            parsed = _kernels.parse_bvh_rows(text, width, limit, final)
            values, consumed, fault = parsed[0], parsed[2], parsed[4]
            assert not fault
            blocks.append(values)
            text = text[consumed:]
            if final and not text:
                return np.concatenate(blocks)
            starved = len(values) < limit


def authoring(work: str, frames: str, joints: str, runs: str) -> dict[str, Any]:
    """Time AnimationWriter and a bare loop over SetTimeSample, both with saving."""
    data = _Samples(int(frames), int(joints))
    taken = timed_in_turn(
        {
            "AnimationWriter": lambda: _author_animtool(data, Path(work) / "a.usdc"),
            "layer route": lambda: _author_layer(data, Path(work) / "b.usdc"),
            "AnimationWriter, extents": lambda: _author_animtool(
                data, Path(work) / "c.usdc", extents=True
            ),
        },
        int(runs),
    )
    sizes = [(Path(work) / f"{name}.usdc").stat().st_size for name in "abc"]
    return {"taken": taken, "bytes": sizes}


class _Samples:
    """Random samples in the types of USD."""

    def __init__(self, frames: int, joints: int) -> None:
        rng = np.random.default_rng(SEED)
        self.frames = frames
        self.names = [f"joint_{i}" for i in range(joints)]
        self.codes = np.arange(1.0, frames + 1.0)
        shape = (frames, joints)
        self.translations = rng.standard_normal((*shape, 3), np.float32)
        turns = rng.standard_normal((*shape, 4), np.float32)
        self.rotations = turns / np.linalg.norm(turns, axis=-1, keepdims=True)
        self.scales = np.ones((*shape, 3), np.float16)
        self.extents = rng.standard_normal((frames, 2, 3), np.float32)

    def blocks(self) -> Iterator[Any]:
        """Yield blocks as large as those of a BVH file with so many joints."""
        from animtool.formats.bvh.lines import BLOCK_VALUES
        from animtool.usd.layers.jobs import WrittenBlock

        size = BLOCK_VALUES // (3 * len(self.names) + 3)
        for start in range(0, self.frames, size):
            part = slice(start, start + size)
            yield WrittenBlock(
                codes=self.codes[part],
                translations=self.translations[part],
                rotations=self.rotations[part],
                scales=self.scales[part],
                extents=self.extents[part],
                root=None,
                error=0.0,
                error_code=0.0,
                error_joint_index=0,
            )


def _author_animtool(data: _Samples, path: Path, *, extents: bool = False) -> Any:
    from pxr import Sdf

    from animtool.usd.layers.names import RigPaths
    from animtool.usd.layers.sdf import new_layer, prim_spec, save_layer
    from animtool.usd.takes.joint_writer import AnimationWriter

    layer, paths = new_layer(path), RigPaths.from_model("/model")
    with Sdf.ChangeBlock():
        prim_spec(layer, paths.root, "SkelRoot")
        writer = AnimationWriter(layer, paths, data.names)
        for block in data.blocks():
            writer.add(block)
        writer.finish([], disables_root_motion=False)
    if extents:
        with Sdf.ChangeBlock():
            writer.author_bounds(writer.padded_bounds(0.0))
    save_layer(layer, path)
    return layer


def _author_layer(data: _Samples, path: Path) -> Any:
    """Author the same samples with as little as USD's Python needs."""
    from pxr import Sdf, Vt

    path.unlink(missing_ok=True)
    layer = Sdf.Layer.CreateNew(str(path))
    types = Sdf.ValueTypeNames
    with Sdf.ChangeBlock():
        spec = Sdf.CreatePrimInLayer(layer, "/model/Rig/Anim")
        spec.specifier, spec.typeName = Sdf.SpecifierDef, "SkelAnimation"
        joints = Sdf.AttributeSpec(
            spec, "joints", types.TokenArray, Sdf.VariabilityUniform
        )
        joints.default = Vt.TokenArray(data.names)
        scales = Sdf.AttributeSpec(spec, "scales", types.Half3Array)
        scales.default = Vt.Vec3hArray.FromNumpy(data.scales[0])
        turns = Sdf.AttributeSpec(spec, "rotations", types.QuatfArray).path
        moves = Sdf.AttributeSpec(spec, "translations", types.Float3Array).path
        put = layer.SetTimeSample
        quaternions, vectors = Vt.QuatfArray.FromNumpy, Vt.Vec3fArray.FromNumpy
        for i, code in enumerate(data.codes.tolist()):
            put(turns, code, quaternions(data.rotations[i]))
            put(moves, code, vectors(data.translations[i]))
    layer.Save()
    return layer


PARTS: dict[str, Callable[..., dict[str, Any]]] = {
    "authoring": authoring,
    "errors": errors,
    "kernel": kernel,
    "make-long": make_long,
}

if __name__ == "__main__":
    print("\n" + json.dumps(PARTS[sys.argv[1]](*sys.argv[2:])))
