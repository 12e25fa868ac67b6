"""Flocks: members that attract, align with and repel those in sight."""
