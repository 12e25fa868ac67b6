"""Rigid bodies: they fall, tumble, collide, stack and hang on joints."""
