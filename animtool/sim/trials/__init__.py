"""Trials: one simulation under several settings, with cost and error of each."""
