"""Make ``bounce.clip.yaml``: arcs under gravity, squash that keeps the volume, spin.

A fall is a parabola and a parabola is a cubic Bézier with its handles at thirds of the
segment, on the tangents at its ends. At 24 fps gravity is 9.81 / 24² m a frame squared.
The ball travels as far as it rolls.

Usage: ``python make_bounce.py [OUT]``; ``OUT`` is ``bounce.clip.yaml`` beside this file
unless given.
"""

from __future__ import annotations

import argparse
import itertools
import math
from pathlib import Path

GRAVITY = 9.81 / 24**2  # [m/frame²]
RADIUS = 0.11  # [m]
DROP = 16  # [frames] from the hand to the floor
ARCS = (24, 18, 14, 10, 8, 6)  # [frames] in the air, a quarter less each time
TOUCH = 2  # [frames] on the floor between two arcs
ROLL = 24  # [frames] until it lies still
TURN = 10.0  # [deg/frame]
SPEED = RADIUS * math.radians(TURN)  # [m/frame] it rolls and does not slip
SQUASH, STRETCH = -0.5, 0.2  # logarithm of the height at the hardest hit
# Squash about the middle of a touch, which is 0: frames, then share of each.
NEAR = ((-6, 0.0, 0.0), (-1, 0.0, 1.0), (0, 1.0, 0.0), (1, 0.0, 1.0), (6, 0.0, 0.0))

Arc = tuple[float, float, float]  # leaves, lands, upward speed [m/frame]


def arcs() -> list[Arc]:
    """Return the flights; the first begins at its top."""
    found: list[Arc] = [(1.0, 1.0 + DROP, 0.0)]
    for frames in ARCS:
        start = found[-1][1] + TOUCH
        found.append((start, start + frames, GRAVITY * frames / 2))
    return found


def log_height(t: float) -> float:
    """Return the logarithm of the ball's height, as a share of its own, at a frame."""
    total = 0.0
    flights = arcs()
    for _, land, _ in flights[:-1]:
        fallen = next(b - a for a, b, _ in flights if b == land)
        speed = fallen if land == flights[0][1] else fallen / 2
        x = t - land - TOUCH / 2
        for (a, *one), (b, *two) in itertools.pairwise(NEAR):
            if a <= x < b:
                s = (1 - math.cos(math.pi * (x - a) / (b - a))) / 2
                squash, stretch = (
                    p + s * (q - p) for p, q in zip(one, two, strict=True)
                )
                total += (squash * SQUASH + stretch * STRETCH) * speed / DROP
    return total


def number(value: float) -> str:
    """Return a number as YAML, shortest that reads back the same."""
    return repr(float(value)).removesuffix(".0")


def vector(*values: float) -> str:
    """Return numbers as a YAML list."""
    return f"[{', '.join(number(v + 0.0) for v in values)}]"


def travel() -> list[str]:
    """Return the keys of the ball's place: flights, touches, and the roll."""
    lines, into = [], ""
    flights = arcs()
    for start, land, up in flights:
        third = (land - start) / 3
        y = GRAVITY * DROP**2 / 2 if start == 1 else 0.0
        down = up - GRAVITY * (land - start)
        leave = vector(SPEED * third, up * third, 0)
        lines.append(
            f"  - {{t: {number(start)}, v: {vector(SPEED * (start - 1), y, 0)}{into}, "
            f"out: [{number(third)}, {leave}]}}"
        )
        come = vector(-SPEED * third, -down * third, 0)
        last = land == flights[-1][1]
        after = ROLL / 3 if last else TOUCH / 3
        behind = vector(SPEED * after, 0, 0)
        lines.append(
            f"  - {{t: {number(land)}, v: {vector(SPEED * (land - 1), 0, 0)}, "
            f"in: [{number(-third)}, {come}], out: [{number(after)}, {behind}]}}"
        )
        into = f", in: [{number(-after)}, {vector(-SPEED * after, 0, 0)}]"
    end = flights[-1][1]
    still = vector(SPEED * (end - 1 + ROLL / 2), 0, 0)
    lines.append(f"  - {{t: {number(end + ROLL)}, v: {still}, in: flat}}")
    return lines


def squash() -> list[str]:
    """Return the keys of the scale: quarter frames where it is not 1."""
    lines = []
    ends = arcs()[-1][1]
    times = [1 + k / 4 for k in range(int(4 * (ends + ROLL - 1)) + 1)]
    heights = [math.exp(log_height(t)) for t in times]
    for k, (t, y) in enumerate(zip(times, heights, strict=True)):
        if y == 1.0 and all(h == 1.0 for h in heights[max(k - 1, 0) : k + 2]):
            continue
        x = 1 / math.sqrt(y)
        lines.append(f"  - {{t: {number(t)}, v: {vector(x, y, x)}}}")
    return lines


def spin() -> list[str]:
    """Return the keys of the turn: even, then to rest as the roll does."""
    end = arcs()[-1][1]
    turned = -TURN * (end - 1)
    third = ROLL / 3
    return [
        "  - {t: 1, v: [0, 0, 0], interp: linear}",
        f"  - {{t: {number(end)}, v: {vector(0, 0, turned)}, "
        f"out: [{number(third)}, {vector(0, 0, -TURN * third)}]}}",
        f"  - {{t: {number(end + ROLL)}, "
        f"v: {vector(0, 0, turned - TURN * ROLL / 2)}, in: flat}}",
    ]


def clip_text() -> str:
    """Return the clip as YAML."""
    last = arcs()[-1][1] + ROLL
    lines = [
        "# A ball dropped from 2.18 m. Made by make_bounce.py: change it there.",
        "clip: animtool/1",
        "name: bounce",
        "rig: ../../rigs/ball/ball.rig.yaml",
        "units: {length: m, angle: deg}",
        "fps: 24",
        f"range: [1, {number(last)}]",
        "channels:",
        "",
        "# Parabolas: handles at thirds, on the tangents.",
        "- target: joint/contact.translation",
        "  interp: bezier",
        "  keys:",
        *travel(),
        "",
        "# Squash and stretch: width squared times height is 1.",
        "- target: joint/ball.scale",
        "  tangents: auto_clamped",
        "  keys:",
        *squash(),
        "",
        "# Euler angles, since a quaternion cannot turn three times round.",
        "- target: joint/spin.rotation",
        "  euler: XYZ",
        "  interp: bezier",
        "  keys:",
        *spin(),
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Write the clip to the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make bounce.clip.yaml.")
    props = Path(__file__).with_name("bounce.clip.yaml")
    parser.add_argument("out", nargs="?", type=Path, default=props)
    out: Path = parser.parse_args().out
    out.write_text(clip_text(), encoding="utf-8", newline="\n")
    print(f"{out}: {len(arcs())} arcs")


if __name__ == "__main__":
    main()
