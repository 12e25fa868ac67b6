"""Rigs, clips and scenes that are valid but for their numbers, baked and read back."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Sdf

from animtool.cli.main import run as animtool
from fuzz.mutations import pick

ABOUT = "rigs, clips and scenes with extreme numbers, baked and read back"

EXTREMES = (
    *("0", "-0.0", "4.9e-324", "1.0e-308", "1.0e-200", "1.0e-46", "1.0e-38"),
    *("1.0e-18", "1.0e-9", "0.5", "1", "2", "24", "1000", "65504", "65520"),
    *("2147483648", "9007199254740993", "1.0e+9", "1.0e+12", "1.0e+17", "1.0e+18"),
    *("1.0000001e+18", "3.3e+38", "3.5e+38", "1.0e+100", "1.7e+308", "1.0e+999"),
    *(".inf", ".nan"),
)
RIG = """\
rig: animtool/1
name: hero
units: {length: cm, angle: deg}
joints:
- {name: hips, type: free, translate: [0, 95, 0], rotate: [0.8, 0, 0.6, 0]}
- {name: arm, parent: hips, type: ball, translate: [20, 30, 0], tips: [[0, 5, 0]],
   limits: {swing: [40, 60], twist: [-20, 20], twist_axis: [1, 0, 0]}}
- {name: elbow, parent: arm, type: pin, axis: [0, 0, 1], translate: [25, 0, 0],
   limits: [0, 150]}
- {name: slide, parent: elbow, type: prismatic, axis: [1, 0, 0],
   mimic: {joint: elbow, gain: 0.1, offset: 2}}
bind: {hips: {translate: [0, 90, 0]}}
shapes: [{name: smile}, {name: jaw}, {name: both, combine: [smile, jaw]}]
controls:
- {name: grin, range: [0, 1], default: 0.2, drives: [
   {shape: smile, expr: "exp(grin * 3) - 1"}, {shape: jaw, curve: [[0, 0], [1, 2]]},
   {joint: hips.translation.x, expr: "grin * 5"}]}
colliders: [{joint: arm, capsule: {radius: 4, length: 20, axis: [1, 0, 0]}}]
"""
CLIP = """\
clip: animtool/1
rig: hero.rig.yaml
fps: 24
range: [1, 6]
channels:
- {target: control/grin, post: cycle_offset, keys: [{t: 1, v: 0, out: [1, 0.5]},
   {t: 4, v: 1, in: [-1, 0.2]}]}
- {target: joint/elbow.angle, pre: linear, post: linear, interp: tcb,
   keys: [{t: 2, v: 0, tcb: [0.5, 0, 0]}, {t: 3, v: 80}, {t: 5, v: 20}]}
- {target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0]}, {t: 6, v: [10, 5, 30]}]}
- {target: joint/arm.rotation, euler: ZXY, keys: [{t: 1, v: [0, 5, 0]},
   {t: 6, v: [700, 5, 30]}]}
- {target: joint/hips.rotation, keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 6, v: [0.6, 0, 0.8, 0]}]}
- {target: joint/arm.scale, keys: [{t: 1, v: [1, 1, 1]}, {t: 6, v: [2, 2, 2]}]}
"""  # noqa: E501
SCENES = (
    """\
scene: animtool/1
fps: 24
rig: hero.rig.yaml
source: {file: hero.clip.yaml}
passes: [{time_scale: {speed: 2, pivot: 3}}]
output: {start: 1001, samples: [-0.25, 0, 0.25]}
""",
    """\
scene: animtool/1
fps: 24
range: [1, 3]
systems:
- rope: {from: [0, 2, 0], to: [1, 2, 0], count: 4, mass: 0.5, tip_mass: 1, drag: 0.1,
    radius: 0.01, gravity: [0, -9.81, 0], pins: [{particles: [start],
    moves: [[0, 0, 0, 0], [0.1, 0.2, 0, 0]]}], wind: {velocity: [1, 0, 0]},
    springs: {structural: {stiffness: 1000, damping: 0.5, ratio: 0.1, rest: 0.9}},
    colliders: [{shape: {sphere: {radius: 0.3}}, at: [0.5, 1, 0], friction: 0.3}]}
""",
    """\
scene: animtool/1
fps: 24
range: [1, 3]
systems:
- particles: {emitters: [{rate: 100, speed: 2, spread: 20, lifetime: 1, radius: 0.01,
    mass: 0.1, at: [0, 1, 0], bursts: [[0, 5]], place: {disc: {radius: 0.2}}}],
    forces: [{gravity: {acceleration: [0, -9.81, 0]}}, {drag: {linear: 0.01}}],
    colliders: [{shape: {plane: {offset: -1}}, restitution: 0.4}],
    step: 0.02, max_particles: 50}
""",
    """\
scene: animtool/1
fps: 24
range: [1, 3]
systems:
- cloth: {across: [1, 0, 0], up: [0, 1, 0], resolution: [3, 3], mass: 0.1,
    pins: [{particles: [top_left]}], wind: {velocity: [2, 0, 1], density: 1.2},
    springs: {structural: {stiffness: 500, ratio: 0.1}, bend: {stiffness: 2}}}
""",
)
OPTIONS = (
    *((), (), (), ("--to-units", "mm"), ("--to-units", "m", "--to-up", "z")),
    *(("--root-motion", "skelroot"), ("--bones",), ("--keep-curves",), ("--clamp",)),
)

# Not a version, nor a part of a name.
_NUMBER = re.compile(r"(?<![\w/.])-?\d+(\.\d+)?(?![\w.])")
# Many particles, frames and steps are no fault, and take their time and memory: of
# these, there are few or more than is allowed.
COUNTS = (
    "0",
    "-1",
    "0.5",
    "1",
    "2",
    "2147483648",
    "1.0e+12",
    "1.0e+18",
    ".inf",
    ".nan",
)
_COUNT = re.compile(
    r"(resolution: \[(3, )?|count: |max_particles: |range: \[(1, )?|step: |^fps: )$",
    re.MULTILINE,
)
_NOT_FINITE = re.compile(r"[\s(,\[-](inf|nan)\b")


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    output = folder / "o.usda"
    rig, clip = folder / "hero.rig.yaml", folder / "hero.clip.yaml"
    scene = folder / "hero.scene.yaml"

    def run(rng: np.random.Generator) -> str:
        kind = int(rng.integers(len(SCENES) + 3))
        simulated = 1 <= kind < len(SCENES)
        source = scene if kind < len(SCENES) else clip
        rig.write_text(_extreme(rng, RIG, 0.5), "utf-8")
        clip.write_text(_extreme(rng, CLIP, 0.7), "utf-8")
        scene.write_text(_extreme(rng, SCENES[kind % len(SCENES)], 1.0), "utf-8")
        options = () if simulated else pick(rng, list(OPTIONS))
        output.unlink(missing_ok=True)
        code = animtool(["bake", str(source), "-o", str(output), *options])
        # A simulation may blow up, which is said.
        assert code in ({0, 3, 4} if simulated else {0, 3}), f"exit {code}"
        assert output.exists() == (code == 0)
        if code:
            return f"refused by exit {code}"
        _check(output)
        return "baked"

    return run


def _extreme(rng: np.random.Generator, text: str, chance: float) -> str:
    """Return a text, with a few of its numbers replaced by extreme ones at times."""
    if rng.random() > chance:
        return text
    found = list(_NUMBER.finditer(text))
    for i in sorted(rng.integers(len(found), size=rng.integers(1, 4)), reverse=True):
        begin, end = found[i].span()
        sign = "-" if rng.random() < 0.2 else ""
        counts = _COUNT.search(text, 0, begin)
        number = pick(rng, list(COUNTS if counts else EXTREMES))
        text = text[:begin] + (sign + number).replace("--", "") + text[end:]
    return text


def _check(path: Path) -> None:
    """Read every value of a file back; none is NaN or infinite."""
    text = path.read_text("utf-8")
    assert not _NOT_FINITE.search(text), "not finite"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(text)
    paths: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    for spec in (
        layer.GetAttributeAtPath(one) for one in paths if one.IsPropertyPath()
    ):
        if spec is None:
            continue
        samples = layer.ListTimeSamplesForPath(spec.path)
        assert np.isfinite(samples).all()
        values = [layer.QueryTimeSample(spec.path, time) for time in samples]
        for value in [*values, spec.default]:
            numbers = np.asarray(value)
            if numbers.dtype.kind == "f":
                assert np.isfinite(numbers).all(), f"{spec.path} is not finite"
