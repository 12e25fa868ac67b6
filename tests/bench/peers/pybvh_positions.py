"""pybvh: parse a BVH file and find where its joints are. Prints seconds as JSON.

A second argument names a file for every nth of the positions, the third says n.
"""

import json
import sys
import time


def main(source: str, output: str = "", every: str = "1") -> None:
    """Parse, run forward kinematics; no USD is written."""
    import pybvh

    began = time.perf_counter()
    # Naming the up axis spares it a search.
    take = pybvh.Bvh.from_file(source, world_up="+y")
    positions = take.joint_positions()
    total = time.perf_counter() - began
    if output:
        import numpy as np

        chosen = positions[:: int(every)]
        np.savez(output, names=np.array(take.joint_names), positions=chosen)
    print(json.dumps({"seconds": {"total": total}}))


if __name__ == "__main__":
    main(*sys.argv[1:])
