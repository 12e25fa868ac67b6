"""Pages read again: a second, plain reading of what is in them."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

_TYPES = {"u8": "<u1", "i16": "<i2", "u16": "<u2", "f32": "<f4", "u32": "<u4"}


@dataclass(frozen=True)
class ReadPage:
    """The text of a page."""

    text: str

    @cached_property
    def manifest(self) -> dict[str, Any]:
        found = re.findall(
            r'<script type="application/json" id="manifest">(.*?)</script>',
            self.text,
            re.S,
        )
        assert len(found) == 1
        manifest: dict[str, Any] = json.loads(found[0])
        return manifest

    @cached_property
    def blocks(self) -> list[bytes]:
        """The blocks, each as it was before it was deflated."""
        texts = re.findall(r'class="block" id="b(\d+)">([^<]*)</script>', self.text)
        assert [int(number) for number, _ in texts] == list(range(len(texts)))
        return [zlib.decompress(base64.b64decode(text), -15) for _, text in texts]

    def values(self, number: int) -> np.ndarray:
        """Return the values of a stream ``(samples, width)``, as the contract says."""
        streams = self.manifest["streams"]
        stream = streams[number]
        width = stream["width"]
        parts = []
        for block, first, samples in stream["block"]:
            begin = 0
            for other in streams:
                for index, start, count in other["block"]:
                    if index == block and other["id"] < number:
                        assert (start, count) == (first, samples)
                        size = np.dtype(_TYPES[other["kind"]]).itemsize
                        begin += other["width"] * count * size
            parts.append(self._part(stream, block, begin, samples, width))
        stored = np.concatenate(parts)
        values = stored.astype(float)
        if stream.get("gaps"):
            values[stored == -32768] = np.nan
        scale = np.resize(np.atleast_1d(stream["scale"]), width)
        return np.resize(np.atleast_1d(stream["offset"]), width) + scale * values

    def _part(
        self, stream: dict[str, Any], block: int, begin: int, samples: int, width: int
    ) -> np.ndarray:
        kind = np.dtype(_TYPES[stream["kind"]])
        many = samples * width
        raw = self.blocks[block][begin : begin + many * kind.itemsize]
        rows, columns = (1, many) if samples == 1 else (width, samples)
        planes = np.frombuffer(raw, np.uint8).reshape(rows, kind.itemsize, columns)
        whole = np.ascontiguousarray(planes.swapaxes(1, 2)).view(kind)[..., 0]
        if stream["coding"] == "delta":
            unsigned = whole.view(f"<u{kind.itemsize}")
            whole = np.cumsum(unsigned, axis=1, dtype=unsigned.dtype).view(kind)
        return whole.reshape(1, -1) if samples == 1 else whole.T

    def locals(self, take: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return translations and rotations of all joints in all frames of a take."""
        entry = self.manifest["takes"][take]
        first, last = entry["span"]
        made = []
        for kind in "tr":
            whole = np.repeat(
                np.array(entry["still"][kind])[None], last - first + 1, axis=0
            )
            if entry[kind] is not None:
                moving = entry["moving"][kind]
                values = self.values(entry[kind])
                whole[:, moving] = values.reshape(len(whole), len(moving), -1)
            made.append(whole)
        return made[0], made[1]
