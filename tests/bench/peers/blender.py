"""Blender as a module: import a BVH file, export USD. Prints its seconds as JSON."""

import json
import sys
import time


def main(source: str, output: str) -> None:
    """Bake ``source`` to ``output`` in a scene that holds nothing else."""
    began = time.perf_counter()
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.use_global_undo = False
    started = time.perf_counter()
    bpy.ops.import_anim.bvh(
        filepath=source, update_scene_fps=True, update_scene_duration=True
    )
    imported = time.perf_counter()
    bpy.ops.wm.usd_export(
        filepath=output,
        export_animation=True,
        export_materials=False,
        convert_world_material=False,
    )
    exported = time.perf_counter()
    seconds = {
        "start": started - began,
        "import": imported - started,
        "export": exported - imported,
        "total": exported - started,
    }
    print("\n" + json.dumps({"seconds": seconds}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
