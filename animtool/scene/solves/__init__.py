"""Solves from files to files: targets, markers, faces, other skeletons."""
