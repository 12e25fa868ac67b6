"""Fast dances of the biped, in any size, with what hangs on it: files of scenes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from animtool.maths import so3

__all__ = ["DANCES", "write_dance"]

FPS = 24
BIPED = Path(__file__).parents[2] / "rigs" / "biped"
X, Y, Z = np.eye(3)


def write_dance(
    folder: Path,
    dance: str,
    size: float = 1.0,
    frames: int = 72,
    what: str = "cape",
    **options: object,
) -> Path:
    """Write a rig, a clip and a scene; return the scene.

    Args:
        folder: Where to.
        dance: Of `DANCES`.
        size: Lengths of the rig over those of the biped [1].
        frames: How many, at `FPS`.
        what: The attachment that the pass `simulate` moves.
        options: Of that pass.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _write_rig(folder, size)
    moved = DANCES[dance](np.arange(frames) / FPS)
    channels = [
        {
            "target": f"joint/{name}",
            "interp": "slerp" if values.shape[1:] == (4,) else "linear",
            "keys": [
                {"t": k + 1, "v": row} for k, row in enumerate(_rows(values, size))
            ],
        }
        for name, values in moved.items()
    ]
    clip: dict[str, Any] = {
        "clip": "animtool/1",
        "name": dance,
        "rig": "dancer.rig.yaml",
        "fps": FPS,
        "range": [1, frames],
        "channels": channels,
    }
    (folder / "dance.clip.yaml").write_text(json.dumps(clip))
    scene = {
        "scene": "animtool/1",
        "source": {"file": "dance.clip.yaml"},
        "passes": [{"simulate": {"what": [what], **options}}],
        "output": {"file": "dance.usdc", "deform": True},
    }
    path = folder / "dance.scene.yaml"
    path.write_text(json.dumps(scene))
    return path


def _rows(values: np.ndarray, size: float) -> list[Any]:
    """Return rows of a channel as a clip has them: w first, in the size of the rig."""
    if values.ndim == 1:
        return values.tolist()
    if values.shape[1] == 4:
        return np.roll(so3.align_signs(values), 1, axis=1).tolist()
    return (values * size).tolist()


def _write_rig(folder: Path, size: float) -> None:
    document = yaml.safe_load((BIPED / "biped.rig.yaml").read_text())
    for joint in document["joints"]:
        if "translate" in joint:
            joint["translate"] = [size * value for value in joint["translate"]]
        if "tips" in joint:
            joint["tips"] = [[size * value for value in tip] for tip in joint["tips"]]
    for collider in document["colliders"]:
        capsule = collider["capsule"]
        for key in ("radius", "length"):
            capsule[key] *= size
        capsule["offset"] = [size * value for value in capsule.get("offset", [0, 0, 0])]
    (folder / "dancer.rig.yaml").write_text(json.dumps(document))
    for name in ("body", "cape", "hair"):
        with np.load(BIPED / f"{name}.npz") as archive:
            arrays = dict(archive)
        arrays["points"] = size * arrays["points"]
        np.savez(folder / f"{name}.npz", **arrays)


def _turned(axis: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    return so3.from_axis_angle(axis, np.radians(degrees))


def _arms(swing: np.ndarray, lowered: np.ndarray) -> dict[str, np.ndarray]:
    """Return turns of both shoulders: down from the sides, and forwards."""
    return {
        "shoulder_l.rotation": so3.multiply(_turned(Y, -swing), _turned(Z, -lowered)),
        "shoulder_r.rotation": so3.multiply(_turned(Y, -swing), _turned(Z, lowered)),
    }


def _turns(t: np.ndarray) -> Mapping[str, np.ndarray]:
    """Return a dance of turns by 200 degrees to either side, every two seconds."""
    phase = np.pi * t
    place = np.stack([0.2 * np.sin(phase), -0.02 + 0 * t, 0.2 * np.cos(phase) - 0.2], 1)
    return {
        "hips.translation": place,
        "hips.rotation": _turned(Y, 200 * np.sin(phase)),
        "spine_3.rotation": _turned(X, 8 * np.sin(2 * phase)),
        **_arms(20 * np.sin(2 * phase), 40 + 10 * np.sin(3 * phase)),
    }


def _jumps(t: np.ndarray) -> Mapping[str, np.ndarray]:
    """Return jumps of 0.35 m every 0.75 s, bent between, that turn by 120 degrees."""
    share = np.remainder(t / 0.75, 1.0)
    air = np.clip((share - 0.25) / 0.7, 0.0, 1.0)
    rise = 0.35 * 4 * air * (1 - air)
    bent = np.where(share < 0.25, np.sin(np.pi * share / 0.25) ** 2, 0.0)
    bend = 35 * bent
    place = np.stack([0 * t, rise - 0.16 * bent, 0.15 * np.sin(np.pi * t)], axis=1)
    legs = {}
    for side in "lr":
        legs[f"hip_{side}.rotation"] = _turned(X, -bend)
        legs[f"knee_{side}.angle"] = 2 * bend
    return {
        "hips.translation": place,
        "hips.rotation": so3.multiply(
            _turned(Y, 120 * np.sin(4 * np.pi * t / 3)), _turned(X, 10 * bent)
        ),
        **legs,
        **_arms(15 * np.sin(4 * np.pi * t), 15 - 10 * np.sin(8 * np.pi * t / 3)),
    }


DANCES = {"turns": _turns, "jumps": _jumps}
