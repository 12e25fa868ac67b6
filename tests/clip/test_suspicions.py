"""Warnings about keys in another unit or order."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.clip.clip import Clip

RIG = """\
rig: animtool/1
name: leg
units: {length: cm, angle: deg}
joints:
- {name: hips, type: free, translate: [0, 90, 0]}
- {name: thigh, parent: hips, type: ball}
- {name: knee, parent: thigh, type: pin, axis: [1, 0, 0], translate: [0, -42, 0]}
- {name: foot, parent: knee, type: ball, translate: [0, -40, 0]}
"""
KNEE = "joint/knee.angle", "", [0, 60, 0]
ROOT = "joint/hips.translation", ""


def codes(
    folder: Path, *channels: tuple[str, str, list[object]], units: str = "{}"
) -> list[str]:
    (folder / "leg.rig.yaml").write_text(RIG, "utf-8")
    lines = ["clip: animtool/1", "rig: leg.rig.yaml", "fps: 24", f"units: {units}"]
    lines += ["channels:"]
    for target, extra, values in channels:
        keys = ", ".join(f"{{t: {1 + 12 * k}, v: {v}}}" for k, v in enumerate(values))
        lines += [f"- {{target: {target}, {extra}keys: [{keys}]}}"]
    path = folder / "a.clip.yaml"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return [notice.code for notice in Clip.load(path).notices]


def eulers(scale: float) -> list[tuple[str, str, list[object]]]:
    """Return six moving channels, a knee among them, up to a scale."""
    row = [[0, 0, 0], [scale, 0.3 * scale, 0], [0.1, 0, 0]]
    parts = [("joint/thigh.rotation", "euler: XYZ, ", row)]
    parts += [("joint/foot.rotation", "euler: XYZ, ", row)]
    return [*parts, ("joint/hips.rotation", "euler: XYZ, ", row)]


@pytest.mark.parametrize(
    "channel",
    [
        ("joint/knee.angle", "", [0, 1.5708, 0]),
        ("joint/thigh.rotation", "euler: XYZ, ", [[0, 0, 0], [-0.7854, 0.2, 0]]),
    ],
)
def test_radians_where_degrees_are_declared(
    tmp_path: Path, channel: tuple[str, str, list[object]]
) -> None:
    assert codes(tmp_path, channel) == ["CLIP107"]
    assert codes(tmp_path, channel, units="{angle: rad}") == []


def test_degrees_where_radians_are_declared(tmp_path: Path) -> None:
    assert codes(tmp_path, KNEE, units="{angle: rad}") == ["CLIP107"]
    assert (
        codes(
            tmp_path, ("joint/knee.angle", "", [0, 9.42477, 62.8]), units="{angle: rad}"
        )
        == []
    )


def test_small_motion_is_plausible(tmp_path: Path) -> None:
    assert codes(tmp_path, ("joint/knee.angle", "", [0, 1.5, 0.4])) == []
    assert codes(tmp_path, *eulers(1.3)) == []


def test_w_last(tmp_path: Path) -> None:
    at = "joint/thigh.rotation", ""
    assert codes(tmp_path, (*at, [[0, 0, 0, 1], [0.3, 0, 0, 0.954]])) == ["CLIP106"]
    assert codes(tmp_path, (*at, [[1, 0, 0, 0], [0, 0, 0, 1]])) == []
    assert codes(tmp_path, (*at, [[0, 0, 0, -1], [0.1, 0, 0, 0.995]])) == []


def test_metres_in_a_clip_in_centimetres(tmp_path: Path) -> None:
    root = (*ROOT, [[0, 0, 0], [0, 0.1, 0.6], [0, 0, 1.2]])
    assert codes(tmp_path, root, KNEE) == ["CLIP108"]
    assert codes(tmp_path, root, KNEE, units="{length: m}") == []
    assert codes(tmp_path, root) == []  # nothing rotates
    sway = (*ROOT, [[0, 0, 0], [0, 0, 1.2], [0, 0, 0]])
    assert codes(tmp_path, sway, KNEE) == []


def test_a_root_faster_than_any_fall(tmp_path: Path) -> None:
    assert codes(tmp_path, (*ROOT, [[0, 0, 0], [4800, 0, 0]]), KNEE) == ["CLIP109"]
    assert codes(tmp_path, (*ROOT, [[0, 0, 0], [1000, 0, 0]]), KNEE) == []
