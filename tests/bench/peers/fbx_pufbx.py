"""pufbx: load an FBX and bake its first stack at a rate. Prints its seconds as JSON.

A third argument names a file for the rotations of its nodes.
"""

import json
import sys

import numpy as np
from clock import timed
from pufbx import bake_anim, load_fbx


def main(source: str, runs: str, output: str = "") -> None:
    """Load ``source`` and bake it, keys as arrays."""
    found = {}

    def work() -> None:
        scene = load_fbx(source)
        baked = bake_anim(scene, scene.anim_stacks[0].anim, resample_rate=30.0)
        for node in baked.modified_nodes:
            keys = node.translation_keys, node.rotation_keys, node.scale_keys
            found[scene.nodes[node.typed_id].name] = keys

    taken = [timed(work) for _ in range(int(runs) + 1)]
    if output:
        rows = {name: keys[1]["value"] for name, keys in found.items()}
        names = {"x": 0, "y": 1, "z": 2, "w": 3}
        arrays = {
            name: np.stack([value[part] for part in names], axis=1)
            for name, value in rows.items()
        }
        np.savez(output, **arrays)
    # The first warms up.
    print("\n" + json.dumps({"taken": taken[1:]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
