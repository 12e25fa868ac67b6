"""Table of finding codes with a safe fix, and the function that makes each edit.

Does not need pxr.
"""

from __future__ import annotations

# In order of application: times first, extents last, as they depend on all others.
EDITS_BY_CODE = {
    "MOT216": "animtool.usd.fixes.timing:snap_to_frames",
    "USD252": "animtool.usd.fixes.timing:author_rates",
    "USD254": "animtool.usd.fixes.timing:fit_range",
    "USD255": "animtool.usd.fixes.timing:fit_range",
    "USD256": "animtool.usd.fixes.timing:widen_range",
    "USD289": "animtool.usd.fixes.timing:round_range",
    "MOT217": "animtool.usd.fixes.timing:fit_range",
    "USD211": "animtool.usd.fixes.structure:replace_by_default",
    "USD236": "animtool.usd.fixes.structure:apply_binding_api",
    "USD259": "animtool.usd.fixes.structure:set_default_prim",
    "USD201": "animtool.usd.fixes.structure:author_unit_scales",
    "USD229": "animtool.usd.fixes.structure:author_rest_from_bind",
    "USD239": "animtool.usd.fixes.structure:author_rest_from_bind",
    "USD203": "animtool.usd.fixes.timing:normalize_rotations",
    "USD204": "animtool.usd.fixes.timing:align_rotation_signs",
    "USD232": "animtool.usd.fixes.structure:normalize_weights",
    "USD250": "animtool.usd.fixes.structure:author_computed_extent",
    "USD251": "animtool.usd.fixes.structure:author_computed_extent",
}
