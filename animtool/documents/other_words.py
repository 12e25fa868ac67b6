"""Terms of other tools for keys and values, and their names here."""

from __future__ import annotations

# Directions by axis name.
AXES = {
    f"{sign}{name}": [(-1.0 if sign else 1.0) * (i == k) for i in range(3)]
    for k, name in enumerate("XYZ")
    for sign in ("", "-")
}
# Values by the names that other tools use for them.
OTHER_VALUES = {
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
    "inch": "in",
    "inches": "in",
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "radians": "rad",
    "y-up": "Y",
    "z-up": "Z",
}
# Keys by the names that other tools use for them, in lower case without underscores.
OTHER_KEYS = {
    "rotateorder": ("euler", "channels"),
    "rotationorder": ("euler", "channels"),
    "framerate": ("fps",),
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
    "position": ("translate", "at"),
    "rotation": ("rotate",),
    "orientation": ("rotate",),
    "bones": ("joints",),
    "controllers": ("controls",),
    "blendshapes": ("shapes",),
    "file": ("source",),
    "input": ("source",),
    "interpolation": ("interp",),
    "target": ("effector",),
    "from": ("source",),
    "pos": ("position",),
}
