"""Flocks: members that attract, align and repel those whom they see."""
