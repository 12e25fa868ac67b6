"""Pages of the viewer made of arrays, by the contract, without any file of animtool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.maths import so3
from animtool.preview.page import page_parts
from animtool.preview.streams import (
    QuantizedValues,
    StreamPacker,
    json_numbers,
    quantize_range,
    quantize_units,
)

Array = npt.NDArray[Any]
UP = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Chain:
    """A chain of joints, each above its parent, that sways while its root walks.

    Attributes:
        translations: Local ``(F, J, 3)``.
        rotations: Local ``(F, J, 4)``.
    """

    names: list[str]
    translations: Array
    rotations: Array

    @classmethod
    def swaying(
        cls,
        frames: int = 48,
        joints: int = 6,
        *,
        speed: float = 0.0,
        phase: float = 0.0,
    ) -> Chain:
        translations = np.zeros((frames, joints, 3))
        translations[:, 1:, 1] = 0.3
        translations[:, 0] = [0.0, 0.4, 0.0]
        translations[:, 0, 0] += np.arange(frames) * speed
        angles = 0.35 * np.sin(
            np.arange(frames)[:, None] * 0.2 + np.arange(joints) * 0.7 + phase
        )
        vectors = np.zeros((frames, joints, 3))
        vectors[..., 2] = angles
        vectors[..., 0] = angles[:, ::-1] * 0.5
        names = [f"joint{j}" for j in range(joints)]
        return cls(names, translations, so3.exp(vectors))

    @property
    def parents(self) -> list[int]:
        return list(range(-1, len(self.names) - 1))

    def world(self) -> tuple[Array, Array]:
        """Return rotations ``(F, J, 4)`` and positions ``(F, J, 3)`` in the world."""
        rotations, positions = self.rotations.copy(), self.translations.copy()
        for j in range(1, len(self.names)):
            positions[:, j] = positions[:, j - 1] + so3.rotate(
                rotations[:, j - 1], self.translations[:, j]
            )
            rotations[:, j] = so3.multiply(rotations[:, j - 1], self.rotations[:, j])
        return rotations, positions


@dataclass
class PageDraft:
    """A page while it is put together."""

    count: int = 48
    first: float = 1001
    rate: tuple[int, int] = (24, 1)
    title: str = "sway.bvh"
    packer: StreamPacker = field(default_factory=StreamPacker)
    parts: dict[str, Any] = field(default_factory=dict)

    def add(self, kind: str, **entry: Any) -> dict[str, Any]:
        self.parts.setdefault(kind, []).append(entry)
        return entry

    def moving(self, values: Array) -> int:
        """Return a stream of float32 values ``(F, ...)``."""
        rows = np.asarray(values, np.float32).reshape(len(values), -1)
        return self.packer.add(QuantizedValues(rows, "f32"))

    def take(self, chain: Chain, name: str = "sway", **more: Any) -> dict[str, Any]:
        frames = len(chain.translations)
        moving = np.flatnonzero(np.ptp(chain.translations, axis=0).any(axis=-1))
        still = {
            "t": json_numbers(chain.translations[0], 9),
            "r": json_numbers(chain.rotations[0], 9),
            "s": None,
        }
        joints = range(len(chain.names))
        entry = {
            "name": name,
            "skeleton": {
                "names": chain.names,
                "parents": chain.parents,
                "rest": still,
                "tips": [],
            },
            "still": still,
            "moving": {"t": moving.tolist(), "r": [*joints], "s": []},
            "t": None,
            "r": None,
            "s": None,
            "shapes": None,
            "contacts": [],
            "offset": [0, 0, 0],
            "span": [0, frames - 1],
        }
        if len(moving):
            values = chain.translations[:, moving].reshape(frames, -1)
            entry["t"] = self.packer.add(quantize_range(values))
        if joints and frames > 1:
            turns = so3.align_signs(chain.rotations).reshape(frames, -1)
            entry["r"] = self.packer.add(quantize_units(turns))
        return self.add("takes", **(entry | more))

    def channels(self, names: Sequence[str], values: Array, **more: Any) -> None:
        """Add channels with values ``(F, C)``."""
        stream = self.moving(values)
        for column, name in enumerate(names):
            channel = {"name": name, "unit": "", "keys": None, "take": None}
            channel |= {"values": stream, "column": column}
            self.add("channels", **(channel | more))

    def write(self, path: Path) -> Path:
        streams, blocks = self.packer.finish()
        manifest = {
            "format": 1,
            "title": self.title,
            "source": {"files": [self.title], "unit": "cm", "up": "z"},
            "time": {
                "first": self.first,
                "step": 1,
                "count": self.count,
                "rate": [*self.rate],
                "label": f"{self.rate[0]} fps",
            },
            "errors": {"rotation_deg": 0.003, "position_mm": 0.05},
            "notices": [],
            "streams": streams,
            **{kind: self.parts.get(kind, []) for kind in _LISTS},
        }
        path.write_bytes(b"".join(page_parts(manifest, blocks)))
        return path


_LISTS = (
    "takes",
    "meshes",
    "curves3d",
    "points",
    "instances",
    "cameras",
    "channels",
    "findings",
)


def ribbon(
    draft: PageDraft, chain: Chain, take: int = 0, *, reach: float = 0.0
) -> dict[str, Any]:
    """Add a ribbon along a chain at rest, skinned to its joints, with a shape.

    Args:
        draft: The page.
        chain: At rest in its first frame without rotations.
        take: Its number.
        reach: How far the shape moves each vertex along X [m].
    """
    joints = len(chain.names)
    heights = np.cumsum(chain.translations[0, :, 1])
    points = np.array([[x, y, 0.0] for y in heights for x in (-0.06, 0.06)])
    faces = [
        [2 * i + a for a in corner]
        for i in range(joints - 1)
        for corner in ((0, 1, 3), (0, 3, 2))
    ]
    own = np.zeros((2 * joints, 4), np.int64)
    own[:, 0] = np.arange(2 * joints) // 2
    weights = np.zeros((2 * joints, 4))
    weights[:, 0] = 65535
    bind = np.tile(np.eye(4), (joints, 1, 1))
    bind[:, 1, 3] = -heights
    stream = draft.packer.add(
        QuantizedValues(weights.reshape(1, -1).astype("<u2"), "u16", 1 / 65535)
    )
    vertices = np.arange(2 * joints)
    shape = {
        "name": "wide",
        "column": 0,
        "vertices": draft.packer.add_static(vertices, "u32"),
        "offsets": draft.packer.add_static(np.tile([reach, 0, 0], 2 * joints), "f32"),
    }
    return draft.add(
        "meshes",
        name="ribbon",
        take=take,
        points=draft.packer.add_static(points, "f32"),
        faces=draft.packer.add_static(np.array(faces), "u32"),
        skin={
            "palette": [*range(joints)],
            "joints": draft.packer.add_static(own, "u16"),
            "weights": stream,
            "bind": draft.packer.add_static(bind.swapaxes(1, 2), "f32"),
        },
        shapes=[shape] if reach else [],
        cache=None,
        color=[0.8, 0.1, 0.1],
        doubleSided=True,
        visible=None,
    )
