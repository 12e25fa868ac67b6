"""Table of USD codes with a safe fix, and the edit of each.

Does not need pxr.
"""

from __future__ import annotations

# In the order of application: times first, since extents follow from all the others.
EDITS = {
    "MOT216": "animtool.usd.fixes.timing:integer_frames",
    "USD252": "animtool.usd.fixes.timing:rates",
    "USD254": "animtool.usd.fixes.timing:sample_range",
    "USD255": "animtool.usd.fixes.timing:sample_range",
    "USD256": "animtool.usd.fixes.timing:wider_range",
    "USD289": "animtool.usd.fixes.timing:full_range",
    "MOT217": "animtool.usd.fixes.timing:sample_range",
    "USD211": "animtool.usd.fixes.structure:default_value",
    "USD236": "animtool.usd.fixes.structure:binding_api",
    "USD259": "animtool.usd.fixes.structure:default_prim",
    "USD201": "animtool.usd.fixes.structure:unit_scales",
    "USD229": "animtool.usd.fixes.structure:rest_from_bind",
    "USD239": "animtool.usd.fixes.structure:rest_from_bind",
    "USD203": "animtool.usd.fixes.timing:unit",
    "USD204": "animtool.usd.fixes.timing:continuous",
    "USD232": "animtool.usd.fixes.structure:normalised",
    "USD250": "animtool.usd.fixes.structure:computed",
    "USD251": "animtool.usd.fixes.structure:computed",
}
