"""Marker trajectories made whole: points named, swaps and spikes repaired, gaps filled."""
