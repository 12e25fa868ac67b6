"""What becomes of a spoiled file that holds characters, meshes and takes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from animtool.cli.main import run as animtool
from animtool.core.errors import AnimtoolError
from animtool.formats.gltf.read import read_gltf
from animtool.motion.take import TakeStream

# Share of the files that commands are run on, which take longer than reading.
BY_COMMAND = 0.025


def outcome(
    rng: np.random.Generator, path: Path, read: Callable[[Path], TakeStream]
) -> str:
    """Read a file to its end, or run a command on it; return how that ended."""
    if rng.random() < BY_COMMAND:
        return _by_command(rng, path)
    try:
        stream = read(path)
        for block in stream.blocks:
            for channel in (block.translations, block.rotations, block.scales):
                if channel is not None:
                    assert np.isfinite(channel.values).all()
                    assert np.isfinite(channel.rest).all()
        for mesh in stream.rig.meshes:
            assert np.isfinite(mesh.points.load()).all()
    except AnimtoolError as error:
        return error.code
    return "read"


def _by_command(rng: np.random.Generator, path: Path) -> str:
    """Run a command on a file; it ends as it should, and what it writes is read."""
    output = path.with_name("out.glb")
    output.unlink(missing_ok=True)
    command = [
        ["validate", str(path)],
        ["info", str(path)],
        ["convert", str(path), str(output)],
    ][int(rng.integers(3))]
    code = animtool(command)
    assert code in {0, 1, 2, 3}, f"{command[0]}: exit {code}"
    if command[0] == "convert" and code == 0:
        read_gltf(output)
    return f"{command[0]}: exit {code}"
