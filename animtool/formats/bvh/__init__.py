"""Biovision Hierarchy (BVH): a skeleton, and a row of channel values per frame."""
