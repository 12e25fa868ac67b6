"""Biovision Hierarchy (BVH): a skeleton, and a row of channel values per frame."""

from animtool.formats.bvh.read import read_bvh
from animtool.formats.bvh.write import write_bvh

__all__ = ["read_bvh", "write_bvh"]
