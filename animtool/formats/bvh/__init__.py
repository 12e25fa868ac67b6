"""Biovision Hierarchy files (BVH): a skeleton, and a row of channels a frame."""

from animtool.formats.bvh.read import read_bvh
from animtool.formats.bvh.write import write_bvh

__all__ = ["read_bvh", "write_bvh"]
