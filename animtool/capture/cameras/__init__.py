"""Calibrated cameras, and points triangulated from their images."""

from animtool.capture.cameras.camera import Camera, Cameras, project
from animtool.capture.cameras.file import load_cameras
from animtool.capture.cameras.observations import Observations, read_observations
from animtool.capture.cameras.openpose import read_keypoints
from animtool.capture.cameras.report import CameraReport, Triangulation
from animtool.capture.cameras.triangulate import triangulate
from animtool.capture.options import TriangulateOptions

__all__ = [
    "Camera",
    "CameraReport",
    "Cameras",
    "Observations",
    "TriangulateOptions",
    "Triangulation",
    "load_cameras",
    "project",
    "read_keypoints",
    "read_observations",
    "triangulate",
]
