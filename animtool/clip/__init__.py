"""Keyframe clips: channels of keys, read, sampled on a rig, reduced and written."""
