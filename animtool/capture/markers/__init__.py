"""Marker trajectories completed: labelled, swaps and spikes repaired, gaps filled."""
