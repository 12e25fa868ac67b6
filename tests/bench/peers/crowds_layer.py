"""A crowd in a layer, and its numbers alone: prints seconds and bytes as JSON."""

import json
import sys
from pathlib import Path

import numpy as np
from clock import timed
from pxr import Gf, Sdf, Vt

from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems
from animtool.usd.props.characters import CharactersWriter


def main(scene: str, runs: str, output: str) -> None:
    """Time what writes the frames of a scene, and a copy of its samples alone."""
    systems = load_scene(Path(scene)).systems
    last = 480
    runs_open = open_systems(systems, last / 24)
    (crowd,) = (run for run in runs_open if run.name == "people")
    frames = []
    simulated = timed(lambda: frames.extend(crowd.at(k / 24) for k in range(last + 1)))
    report = {}

    def write() -> None:
        layer = Sdf.Layer.CreateNew(output + "/crowd.usdc")
        layer.Clear()
        made = CharactersWriter("/square/people", 1.0, 24.0)
        made.author_prototypes(layer, frames[0])
        for k, frame in enumerate(frames):
            made.add(float(k + 1), frame)
        made.finish(layer)
        layer.Save()
        report.update(own=made.report.own, shared=made.report.shared)
        report.update(error=made.report.error, slide=made.report.slide)

    written = [timed(write) for _ in range(int(runs))]
    source = Sdf.Layer.FindOrOpen(output + "/crowd.usdc")
    samples = []

    def collect(path: Sdf.Path) -> None:
        if path.IsPropertyPath():
            for code in source.ListTimeSamplesForPath(path):
                samples.append((str(path), code, source.QueryTimeSample(path, code)))

    source.Traverse("/", collect)

    def numbers() -> None:
        layer = Sdf.Layer.CreateNew(output + "/numbers.usdc")
        layer.Clear()
        for path in dict.fromkeys(path for path, _, _ in samples):
            other = source.GetAttributeAtPath(path)
            spec = Sdf.CreatePrimInLayer(layer, other.path.GetPrimPath())
            Sdf.AttributeSpec(spec, other.name, other.typeName)
        for path, code, value in samples:
            layer.SetTimeSample(path, code, value)
        layer.Save()

    def whole() -> None:
        layer = Sdf.Layer.CreateNew(output + "/whole.usdc")
        layer.Clear()
        types = Sdf.ValueTypeNames
        turns = np.stack([frame.rotations[0] for frame in frames]).astype(np.float32)
        for i in range(len(frames[0].ids)):
            spec = Sdf.CreatePrimInLayer(layer, f"/agent_{i}")
            poses, place, heading = (
                Sdf.AttributeSpec(spec, name, kind).path
                for name, kind in (
                    ("rotations", types.QuatfArray),
                    ("translate", types.Float3),
                    ("rotateY", types.Float),
                )
            )
            for k, frame in enumerate(frames):
                made = Vt.QuatfArray.FromNumpy(turns[k, i])
                layer.SetTimeSample(poses, k + 1.0, made)
                at = Gf.Vec3f(*frame.points[i].tolist())
                layer.SetTimeSample(place, k + 1.0, at)
                layer.SetTimeSample(heading, k + 1.0, float(frame.headings[i]))
        layer.Save()

    every = [timed(whole) for _ in range(int(runs))]
    alone = [timed(numbers) for _ in range(int(runs))]
    size = Path(output + "/crowd.usdc").stat().st_size
    report.update(
        taken=written, alone=alone, whole=every, simulated=[simulated], bytes=size
    )
    print("\n" + json.dumps(report), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
