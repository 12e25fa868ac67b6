"""Completes marker trajectories: labels points, repairs swaps, fills gaps."""
