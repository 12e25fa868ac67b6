"""Reads shaders and colors from the sources of the page viewer."""

from __future__ import annotations

import re
from functools import cache

from animtool.preview.page import viewer_text

# Constants of viewer modules that contain only GLSL.
_CONSTANT_LINE_PATTERN = re.compile(
    r"^(?:export )?const ([A-Z_]+) = (?:`([^`]*)`|'([^'\n]*)');$", re.M
)
_NAME_PATTERN = re.compile(r"\$\{([A-Z_]+)\}")
_COLOR_PATTERN = re.compile(r"--([\w-]+): #([0-9a-f]{6});")
# Module with the constants that other modules insert.
SHARED_MODULE = "gl.js"
# Header for desktop OpenGL, replacing that of WebGL.
SHADER_HEADER = (
    "#version 330\nprecision highp float;\nprecision highp int;\n"
    "precision highp sampler2D;\n"
)


def shader_source(module: str, constant_name: str) -> str:
    """Return the source of a shader of the viewer.

    >>> shader_source("bones.js", "THIN_FRAGMENT").startswith("in vec3 tint;")
    True
    """
    shared_constants = _shader_constants(SHARED_MODULE)
    shader_by_name = _shader_constants(module)
    return _NAME_PATTERN.sub(
        lambda match: shared_constants[match[1]], shader_by_name[constant_name]
    )


@cache
def _shader_constants(module: str) -> dict[str, str]:
    """Return the GLSL constants of a viewer module."""
    text = viewer_text(module)
    return {name: a or b for name, a, b in _CONSTANT_LINE_PATTERN.findall(text)}


@cache
def theme_colors() -> dict[str, tuple[int, int, int]]:
    """Return the colors of the light theme by name, with components from 0 to 255.

    >>> sorted(theme_colors())[:3]
    ['accent', 'bone', 'contact']
    """
    light_theme = viewer_text("viewer.css").partition("}")[0]
    return {
        name: (int(code[:2], 16), int(code[2:4], 16), int(code[4:], 16))
        for name, code in _COLOR_PATTERN.findall(light_theme)
    }
