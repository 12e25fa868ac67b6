"""What Blender, three.js and NVIDIA's validator make of the USD that animtool writes.

Every shipped rig and sample is written in every form. Blender and three.js read each
file at some frames, and their positions are compared with those in the file; the
validator counts its findings. See README.md beside this file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

READERS = Path(__file__).resolve().parent
sys.path.insert(0, str(READERS.parent))

from figures import Bound, Row, tables  # noqa: E402
from measuring import ROOT, Session, begin, parser  # noqa: E402

MAX_POINTS = 50
# [m] Float32 positions of characters and cloths.
BOUND = 1e-4


@dataclass(frozen=True)
class Sample:
    """A file to read.

    Attributes:
        name: For the table.
        path: The file.
    """

    name: str
    path: Path


@dataclass(frozen=True)
class Reference:
    """What a file says, by USD itself.

    Attributes:
        codes: Time codes that are compared.
        joints: World positions by joint, one a code [m], y up.
        points: Some world points by mesh with samples, one array a code [m], y up.
        fps: Time codes a second.
        frames: Number of samples.
    """

    codes: list[float]
    joints: dict[str, Any]
    points: dict[str, Any]
    fps: float
    frames: int


def animtool(folder: Path, *arguments: str | Path) -> None:
    """Run animtool, which must succeed."""
    command = [sys.executable, "-m", "animtool", *map(str, arguments)]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, cwd=folder
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")


def label(sample: Path) -> str:
    """Return the name of a sample's file, with its folder if that has another name."""
    name, folder = sample.name.split(".")[0], sample.parent.name
    return name if name == folder else f"{folder} {name}"


def written(folder: Path) -> list[Sample]:
    """Write every rig and sample in every form; return the files to open.

    Layers, and chunks of points, are opened by the stage that holds them.
    """
    for name in ("rigs", "samples"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "animtool.toml").touch()
    made = []

    def bake(name: str, *arguments: str | Path, output: str = "") -> None:
        output = output or f"{name.replace(' ', '_')}.usdc"
        animtool(folder, "bake", *arguments, "-o", output, "-q")
        made.append(Sample(name, folder / output))

    for rig in sorted(folder.glob("rigs/*/*.rig.yaml")):
        name = rig.name.removesuffix(".rig.yaml")
        animtool(folder, "convert", rig, f"{name}.usdc", "--physics", "-q")
        made.append(Sample(f"rig {name}", folder / f"{name}.usdc"))
        made.append(Sample(f"physics {name}", folder / f"{name}.physics.usda"))
    clips = [*folder.glob("samples/*/*.clip.yaml"), *folder.glob("samples/*/*.bvh")]
    for sample in sorted(clips):
        bake(f"stage {label(sample)}", sample)
    walk = folder / "samples/walk/walk.bvh"
    stride = folder / "samples/stride/stride.clip.yaml"
    bake("bones walk", walk, "--bones")
    bake("split walk", walk, "--split")
    bake("library walk", walk, "stage_walk.usdc")
    animtool(folder, "convert", "rigs/biped/biped.rig.yaml", "actor.usdc", "-q")
    over = ("--rig-layer", "actor.usdc")
    animtool(folder, "bake", stride, *over, "-o", "over.usdc", "-q")
    made.append(over_rig(folder, "layer stride", "over.usdc"))
    animtool(folder, "bake", stride, *over, "--deform", "-o", "cache.usdc", "-q")
    made.append(over_rig(folder, "points layer stride", "cache.usdc"))
    bake("deform stride", stride, "--deform")
    bake("chunks stride", stride, "--deform", "--chunk", "10")
    for scene in sorted(folder.glob("samples/*/*.scene.yaml")):
        name = f"scene {label(scene)}"
        if scene.parent.name != "shot":
            bake(name, scene)
    animtool(folder, "bake", "samples/shot/shot.scene.yaml", "-q")
    outputs = sorted(folder.glob("samples/shot/*.usd*"))
    made += [Sample(f"shot {p.stem}", p) for p in outputs if p.stem != "set"]
    return made


def over_rig(folder: Path, name: str, layer: str) -> Sample:
    """Write a stage of a layer over its rig, as a shot has them."""
    path = folder / f"{name.replace(' ', '_')}.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    stage.GetRootLayer().subLayerPaths = [f"./{layer}", "./actor.usdc"]
    own = Usd.Stage.Open(str(folder / layer))
    stage.SetStartTimeCode(own.GetStartTimeCode())
    stage.SetEndTimeCode(own.GetEndTimeCode())
    stage.SetTimeCodesPerSecond(own.GetTimeCodesPerSecond())
    stage.SetFramesPerSecond(own.GetFramesPerSecond())
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(own))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(own))
    stage.GetRootLayer().defaultPrim = own.GetRootLayer().defaultPrim
    stage.Save()
    return Sample(name, path)


def reference(path: Path) -> Reference:
    """Return what a file says at its first, last, and two frames between."""
    stage = Usd.Stage.Open(str(path))
    times = sorted(
        {
            time
            for prim in stage.Traverse()
            for attr in prim.GetAuthoredAttributes()
            for time in attr.GetTimeSamples()
        }
    )
    whole = [time for time in times if time == round(time)]
    chosen = np.linspace(0, len(whole) - 1, min(4, len(whole))).astype(int)
    codes = [whole[i] for i in sorted(set(chosen.tolist()))] or [1.0]
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    upright = np.eye(3)
    if UsdGeom.GetStageUpAxis(stage) == "Z":
        upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    joints, points = {}, {}
    for code in codes:
        for name, place in posed(stage, code):
            joints.setdefault(name, []).append(upright @ place * unit)
        for name, places in moving_points(stage, code):
            points.setdefault(name, []).append(places @ upright.T * unit)
    fps = stage.GetTimeCodesPerSecond()
    return Reference(codes, joints, points, fps, len(whole))


def posed(stage: Any, code: float) -> list[tuple[str, Any]]:
    """Return the world position of every joint, by its own name."""
    found = []
    cache = UsdSkel.Cache()
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Root):
            cache.Populate(UsdSkel.Root(prim), Usd.PrimDefaultPredicate)
    for prim in stage.Traverse():
        if not prim.IsA(UsdSkel.Skeleton):
            continue
        query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        poses = query.ComputeJointSkelTransforms(code)
        world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code)
        for joint, pose in zip(query.GetJointOrder(), poses or (), strict=False):
            place = (pose * world).ExtractTranslation()
            found.append((joint.rpartition("/")[2], np.array(place)))
    return found


def moving_points(stage: Any, code: float) -> list[tuple[str, Any]]:
    """Return some world points of every mesh whose points have samples."""
    found = []
    for prim in stage.Traverse():
        mesh = UsdGeom.Mesh(prim)
        if not mesh or not mesh.GetPointsAttr().GetTimeSamples():
            continue
        local = np.array(mesh.GetPointsAttr().Get(code), float)
        world = np.array(mesh.ComputeLocalToWorldTransform(code))
        local = local[:: len(local) // MAX_POINTS + 1]
        found.append((prim.GetName(), local @ world[:3, :3] + world[3, :3]))
    return found


def peer(command: list[str], folder: Path | None = None) -> dict[str, Any] | None:
    """Run a reader; return what it wrote, None where it failed."""
    with tempfile.TemporaryDirectory() as place:
        output = Path(place) / "found.json"
        full = [text if text != "OUTPUT" else str(output) for text in command]
        done = subprocess.run(
            full, check=False, capture_output=True, text=True, cwd=folder
        )
        if done.returncode or not output.is_file():
            lines = (done.stderr or done.stdout).strip().splitlines()
            print(f"{full[2]}: {lines[-1] if lines else done}", file=sys.stderr)
            return None
        return json.loads(output.read_text("utf-8"))


def rows_of(tool: str, name: str, ref: Reference, found: dict[str, Any] | None) -> list:
    """Return the figures of one reader and file."""
    rows = [Row(name, tool, "opens", [float(found is not None)], Bound(True, 1))]
    if found is None:
        return rows
    matched = [joint for joint in ref.joints if joint in found["joints"]]
    if ref.joints:
        rows.append(Row(name, tool, "joints in the file", [len(ref.joints)]))
        rows.append(Row(name, tool, "joints", [len(matched)]))
    if ref.frames > 1:
        rows.append(Row(name, tool, "samples in the file", [ref.frames]))
        if found["keys"]:
            rows.append(Row(name, tool, "keys", [found["keys"]]))
    for kind, mine, theirs in (
        ("joint", ref.joints, found["joints"]),
        ("point", ref.points, found["points"]),
    ):
        error = apart(mine, theirs)
        if error is not None:
            # three.js reads no samples of points.
            known = kind == "point" and tool == "three.js"
            bound = None if known else Bound(False, BOUND)
            rows.append(Row(name, tool, f"largest {kind} error [m]", [error], bound))
    return rows


def apart(mine: dict[str, Any], theirs: dict[str, Any]) -> float | None:
    """Return the largest distance of what both have; None where that is nothing."""
    errors = []
    for name in (name for name in mine if name in theirs):
        a, b = np.array(mine[name], float), np.array(theirs[name], float)
        # Vertices that are split at corners are others.
        if a.shape == b.shape:
            errors.append(float(np.linalg.norm(a - b, axis=-1).max()))
    return max(errors, default=None)


def blender(python: Path, sample: Sample, ref: Reference) -> dict[str, Any] | None:
    """Return what Blender reads, in metres, y up."""
    codes = [f"{code:g}" for code in ref.codes]
    script = str(READERS / "blender_usd.py")
    return peer([str(python), script, str(sample.path), "OUTPUT", *codes])


def three(folder: Path, sample: Sample, ref: Reference) -> dict[str, Any] | None:
    """Return what three.js reads, in metres, y up: its loader converts both."""
    codes = [f"{code:g}" for code in ref.codes]
    script = str(READERS / "three_usd.mjs")
    command = ["node", script, str(sample.path), "OUTPUT", f"{ref.fps:g}", *codes]
    return peer(command, folder)


def findings(validator: Path, path: Path) -> Counter[str]:
    """Return how often each rule of NVIDIA's spoke, as ``severity rule``."""
    report = path.with_name(f"{path.name}.json")
    command = [str(validator), str(path), "--json-output", str(report)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if not report.is_file():
        raise SystemExit(f"{' '.join(command)}\n{done.stderr[-2000:]}")
    return Counter(said(json.loads(report.read_text("utf-8"))))


def said(node: object) -> list[str]:
    """Return severity and rule of every issue, wherever the report holds it."""
    if isinstance(node, dict):
        severity = node.get("severity")
        if isinstance(severity, str):
            rule = node.get("rule")
            name = rule.get("name") if isinstance(rule, dict) else rule
            return [f"{severity} {name}"]
        return [found for value in node.values() for found in said(value)]
    if isinstance(node, list):
        return [found for value in node for found in said(value)]
    return []


def validated(validator: Path, sample: Sample) -> Row:
    """Return how many findings a file has; each is printed."""
    found = findings(validator, sample.path)
    for name, count in sorted(found.items()):
        print(f"{sample.name}: {count} x {name}", file=sys.stderr)
    count = float(sum(found.values()))
    return Row(sample.name, "NVIDIA", "findings", [count], Bound(False, 0))


def started(options: argparse.Namespace) -> Session:
    """Return the run, which knows the versions of all readers."""
    python = options.validator and str(options.validator.with_name("python"))
    packages = ["omniverse-asset-validator", "usd-validation-nvidia", "usd-core"]
    notes = ["left out, no folder was given: three"]
    if options.three:
        package = options.three / "node_modules/three/package.json"
        notes = [f"three {json.loads(package.read_text('utf-8'))['version']}"]
    return begin(
        options,
        (sys.executable, ["usd-core"]),
        (options.bpy_python and str(options.bpy_python), ["bpy"]),
        (python, packages),
        notes=notes,
        clocked=False,
    )


def main() -> None:
    """Write, read, compare, print and store."""
    made = parser(__doc__, "readers.csv", runs=1)
    made.add_argument("--bpy-python", type=Path)
    made.add_argument("--three", type=Path, help="folder with three installed")
    made.add_argument("--validator", type=Path)
    made.add_argument("--only", default="", help="samples with this in their name")
    options = made.parse_args()
    session = started(options)
    rows = []
    with tempfile.TemporaryDirectory() as place:
        for sample in written(Path(place)):
            if options.only not in sample.name:
                continue
            ref = reference(sample.path)
            own = []
            if options.bpy_python:
                found = blender(options.bpy_python, sample, ref)
                own += rows_of("Blender", sample.name, ref, found)
            if options.three:
                found = three(options.three, sample, ref)
                own += rows_of("three.js", sample.name, ref, found)
            if options.validator:
                own.append(validated(options.validator, sample))
            print("\n".join(tables(own)), file=sys.stderr, flush=True)
            rows += own
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
