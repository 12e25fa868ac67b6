"""A beast whose tail swings, as files."""

from __future__ import annotations

from pathlib import Path

__all__ = ["write_beast"]

RIG = """rig: animtool/1
name: beast
units: {length: cm, angle: deg}
joints:
- {name: body, type: free}
"""
CLIP = """clip: animtool/1
rig: beast.rig.yaml
fps: 24
"""


def write_beast(folder: Path, scene: str, bones: int, last: int, way: float) -> Path:
    """Write a rig, its ``swing.clip.yaml`` and a scene, and return that one's path.

    Args:
        folder: Where they are.
        scene: Its text.
        bones: Of the tail, 20 cm each.
        last: The last frame; at the middle between the first and that it turns.
        way: How far the body goes until then [cm].
    """
    rig, names = RIG, [f"tail_{k + 1}" for k in range(bones)]
    for k, name in enumerate(names):
        parent, z = ("body", -10) if k == 0 else (names[k - 1], -20)
        tips = ", tips: [[0, 0, -20]]" if k == bones - 1 else ""
        rig += f"- {{name: {name}, parent: {parent}, type: ball"
        rig += f", translate: [0, 0, {z}]{tips}}}\n"
    chain = ", ".join(names)
    rig += f"attach: [{{name: tail, kind: spring_chain, joints: [{chain}]}}]\n"
    keys = ((1, 0.0), ((1 + last) // 2, way), (last, 0.0))
    written = ", ".join(f"{{t: {t}, v: [{x:g}, 100, 0]}}" for t, x in keys)
    clip = f"{CLIP}range: [1, {last}]\nchannels:\n"
    clip += f"- target: joint/body.translation\n  keys: [{written}]\n"
    (folder / "beast.rig.yaml").write_text(rig, "utf-8")
    (folder / "swing.clip.yaml").write_text(clip, "utf-8")
    path = folder / "swing.scene.yaml"
    path.write_text(scene, "utf-8")
    return path
