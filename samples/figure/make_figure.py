"""Make ``figure.fbx``: the walk of the samples as Mixamo names its joints, in text.

Usage: ``python samples/figure/make_figure.py [FILE]``. The file is as other tools write
one: models, curves in ticks, and connections by number.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

HERE = Path(__file__).parent
WALK = HERE.parent / "walk" / "walk.bvh"
TICKS = 46_186_158_000  # a second
# Of turns about Y, then X, then Z, as the walk has them.
YXZ = 3
NAMES = {"Chest": "Spine1", "LeftToe": "LeftToeBase", "RightToe": "RightToeBase"}
HEAD = """; FBX 7.4.0 project file
FBXHeaderExtension:  {{
\tFBXVersion: 7400
}}
GlobalSettings:  {{
\tProperties70:  {{
\t\tP: "UpAxis", "int", "", "A", 1
\t\tP: "FrontAxis", "int", "", "A", 2
\t\tP: "CoordAxis", "int", "", "A", 0
\t\tP: "UnitScaleFactor", "double", "", "A", 1.0
\t\tP: "TimeMode", "int", "", "A", 6
\t}}
}}
Objects:  {{
{objects}}}
Connections:  {{
{links}}}
"""
MODEL = """\tModel: {own}, "Model::mixamorig:{name}", "LimbNode" {{
\t\tProperties70:  {{
\t\t\tP: "RotationActive", "bool", "", "A", 1
\t\t\tP: "RotationOrder", "enum", "", "A", {order}
\t\t\tP: "Lcl Translation", "Lcl Translation", "", "A", {x}, {y}, {z}
\t\t}}
\t}}
"""
CURVE = """\tAnimationCurve: {own}, "AnimCurve::", "" {{
\t\tKeyTime: *{count} {{
\t\t\ta: {times}
\t\t}}
\t\tKeyValueFloat: *{count} {{
\t\t\ta: {values}
\t\t}}
\t\tKeyAttrFlags: *1 {{
\t\t\ta: 4
\t\t}}
\t\tKeyAttrDataFloat: *4 {{
\t\t\ta: 0,0,0,0
\t\t}}
\t\tKeyAttrRefCount: *1 {{
\t\t\ta: {count}
\t\t}}
\t}}
"""
NODE = '\tAnimationCurveNode: {own}, "AnimCurveNode::{kind}", "" {{\n\t}}\n'
STACK = """\tAnimationStack: 1, "AnimStack::walk", "" {{
\t\tProperties70:  {{
\t\t\tP: "LocalStart", "KTime", "Time", "", 0
\t\t\tP: "LocalStop", "KTime", "Time", "", {last}
\t\t}}
\t}}
\tAnimationLayer: 2, "AnimLayer::base", "" {{
\t}}
"""
PROPERTIES = {"position": ("T", "Lcl Translation"), "rotation": ("R", "Lcl Rotation")}


def joints(lines: Iterator[str]) -> Iterator[tuple[str, int, list[str], list[str]]]:
    """Yield the joints of a BVH: name, parent, offset, channels."""
    above: list[int] = []
    name, count, parent = "", 0, -1
    offset: list[str] = []
    for line in lines:
        word, *rest = line.split()
        if word in {"ROOT", "JOINT"}:
            name, parent = rest[0], above[-1] if above else -1
        elif word == "End":
            name = ""
        elif word == "{":
            above.append(count)
        elif word == "OFFSET":
            offset = rest
        elif word == "CHANNELS":
            yield name, parent, offset, rest[1:]
            count += 1
        elif word == "}":
            above.pop()
        elif word == "MOTION":
            return


def curve(own: int, times: Sequence[int], values: Sequence[float]) -> str:
    """Return a curve with straight lines between its keys."""
    words = ",".join(map(str, times)), ",".join(f"{value:g}" for value in values)
    return CURVE.format(own=own, count=len(times), times=words[0], values=words[1])


def main(output: Path) -> None:
    """Write the file."""
    lines = iter(WALK.read_text("utf-8").splitlines())
    skeleton = list(joints(lines))
    step = float(next(line for line in lines if "Frame Time" in line).split()[-1])
    rows = [[float(word) for word in line.split()] for line in lines if line.strip()]
    times = [round(round(1 / step) ** -1 * i * TICKS) for i in range(len(rows))]
    objects, links = STACK.format(last=times[-1]), '\tC: "OO", 2, 1\n'
    own, column = 1000, 0
    for i, (name, parent, offset, channels) in enumerate(skeleton):
        x, y, z = offset
        model = 100 + i
        objects += MODEL.format(
            own=model, name=NAMES.get(name, name), order=YXZ, x=x, y=y, z=z
        )
        links += f'\tC: "OO", {model}, {100 + parent if parent >= 0 else 0}\n'
        for kind, (short, shown) in PROPERTIES.items():
            axes = [channel for channel in channels if channel.endswith(kind)]
            if not axes:
                continue
            node = own
            objects += NODE.format(own=node, kind=short)
            links += f'\tC: "OO", {node}, 2\n\tC: "OP", {node}, {model}, "{shown}"\n'
            for k, axis in enumerate(axes):
                values = [row[column + channels.index(axis)] for row in rows]
                objects += curve(node + 1 + k, times, values)
                links += f'\tC: "OP", {node + 1 + k}, {node}, "d|{axis[0]}"\n'
            own += 4
        column += len(channels)
    output.write_text(HEAD.format(objects=objects, links=links), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "figure.fbx")
