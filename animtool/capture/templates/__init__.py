"""Marker templates: the joint and offset of each marker."""

from __future__ import annotations

from animtool.capture.templates.file import load_template
from animtool.capture.templates.match import MarkerMatch, match_markers
from animtool.capture.templates.template import MarkerTemplate, TemplateMarker

__all__ = [
    "MarkerMatch",
    "MarkerTemplate",
    "TemplateMarker",
    "load_template",
    "match_markers",
]
