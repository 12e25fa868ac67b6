"""Calibrated cameras, and points from what they see."""

from animtool.mocap.cameras.camera import Camera, Cameras, project
from animtool.mocap.cameras.file import load_cameras
from animtool.mocap.cameras.observations import Observations, read_observations
from animtool.mocap.cameras.openpose import read_keypoints
from animtool.mocap.cameras.report import CameraReport, Triangulation
from animtool.mocap.cameras.triangulate import triangulate
from animtool.mocap.options import TriangulateOptions

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
