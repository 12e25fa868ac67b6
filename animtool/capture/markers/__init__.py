"""Marker trajectories made whole: named, swaps and spikes repaired, gaps filled."""
