"""Keys and values of other tools, with animtool's names for them."""

from __future__ import annotations

from typing import Any

# Directions by axis name.
AXES = {
    f"{sign}{name}": [(-1.0 if sign else 1.0) * (i == axis) for i in range(3)]
    for axis, name in enumerate("XYZ")
    for sign in ("", "-")
}
# Our values by the names that other tools use for them.
VALUE_ALIASES = {
    "hinge": "pin",
    "revolute": "pin",
    "rotational": "pin",
    "slider": "prismatic",
    "slide": "prismatic",
    "spherical": "ball",
    "socket": "ball",
    "floating": "free",
    "root": "free",
    "rigid": "fixed",
    "static": "fixed",
    "ease": "bezier",
    "easein": "bezier",
    "easeout": "bezier",
    "easeinout": "bezier",
    "cubic": "bezier",
    "smooth": "auto",
    "clamped": "auto_clamped",
    "auto": "bezier",
    "constant": "step",
    "stepped": "step",
    "loop": "cycle",
    "repeat": "cycle",
    "meter": "m",
    "meters": "m",
    "metre": "m",
    "metres": "m",
    "centimeter": "cm",
    "centimeters": "cm",
    "centimetres": "cm",
    "millimeters": "mm",
    "millimetres": "mm",
    "0.01": "cm",
    "0.001": "mm",
    "0.0254": "in",
    "inch": "in",
    "inches": "in",
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "radians": "rad",
    "y-up": "Y",
    "z-up": "Z",
}
# Further aliases, for keys that do not allow the value in `VALUE_ALIASES`.
FALLBACK_VALUE_ALIASES = {
    "smooth": "bezier",
    "auto": "auto_clamped",
    "euler": "symplectic_euler",
    "verlet": "velocity_verlet",
    "implicit": "implicit_euler",
}
# Keys by the names that other tools use for them, in lower case without underscores.
KEY_ALIASES = {
    "rotateorder": ("euler", "channels"),
    "rotationorder": ("euler", "channels"),
    "framerate": ("fps",),
    "obstacles": ("colliders",),
    "obstacle": ("colliders",),
    "rate": ("fps",),
    "integrator": ("solver",),
    "timestep": ("step",),
    "resolution": ("size",),
    "translation": ("translate",),
    "rotations": ("rotate",),
    "frame": ("t",),
    "time": ("t", "at"),
    "value": ("v",),
    "lookat": ("aim",),
    "to": ("target",),
    "smooth": ("clean",),
    "start": ("range", "first"),
    "end": ("range", "last"),
    "frames": ("range", "keys"),
    "factor": ("speed", "gain"),
    "joint": ("joints", "root"),
    "keys": ("curve",),
    "position": ("translate", "at"),
    "rotation": ("rotate",),
    "orientation": ("rotate",),
    "bones": ("joints",),
    "controllers": ("controls",),
    "blendshapes": ("shapes",),
    "file": ("source", "take"),
    "input": ("source", "inputs"),
    "bone": ("joint",),
    "interpolation": ("interp",),
    "target": ("effector",),
    "from": ("source",),
    "gravity": ("forces",),
    "pos": ("position", "translate", "v"),
    "rot": ("orientation", "rotate"),
    "trans": ("translate",),
    "orient": ("orientation", "rotate"),
    "begin": ("range", "first"),
    "stop": ("range", "last"),
    "out": ("output",),
}
# Keys that are options of commands only.
COMMAND_KEYS = frozenset({"overwrite", "strict", "skip_existing", "jobs", "debug"})
# Options that are intended by a single value instead of a pass's options, in order.
PASS_OPTIONS = {
    "blend": ("take",),
    "difference": ("base",),
    "hang": ("joint", "system"),
    "ik": ("targets",),
    "layer": ("take",),
    "loop": ("first", "last"),
    "mirror": ("axis",),
    "resample": ("fps",),
    "retarget": ("rig",),
    "root_motion": ("root",),
    "simulate": ("what",),
    "time_scale": ("speed",),
    "time_warp": ("curve",),
    "trim": ("first", "last"),
}


def intended_options(name: str, value: Any) -> dict[str, Any]:
    """Return the options that a single value of a pass means; empty if unclear.

    >>> intended_options("trim", [5, 60]), intended_options("mirror", True)
    ({'first': 5, 'last': 60}, {})
    """
    options = PASS_OPTIONS.get(name, ())
    if isinstance(value, list) and len(value) == len(options) > 1:
        return dict(zip(options, value, strict=True))
    if isinstance(value, bool | dict | None) or not options:
        return {}
    if name == "simulate" and not isinstance(value, list):
        value = [value]
    is_scalar = not isinstance(value, list) or name in {"simulate", "time_warp"}
    return {options[0]: value} if is_scalar else {}
