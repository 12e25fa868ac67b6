"""Solves between files: IK targets, markers, faces, retargeting."""
