"""Marker templates: which marker is on which joint, and where."""

from __future__ import annotations

from animtool.mocap.template.file import load_template
from animtool.mocap.template.match import MarkerMatch, match_markers
from animtool.mocap.template.template import MarkerTemplate, TemplateMarker

__all__ = [
    "MarkerMatch",
    "MarkerTemplate",
    "TemplateMarker",
    "load_template",
    "match_markers",
]
