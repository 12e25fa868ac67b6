"""Marker solve: calibration, and the motion of a rig."""

from __future__ import annotations

from animtool.capture.options import SolveOptions
from animtool.capture.solve.calibration import Calibration, calibrate
from animtool.capture.solve.run import MarkerSolve, solve_markers

__all__ = ["Calibration", "MarkerSolve", "SolveOptions", "calibrate", "solve_markers"]
