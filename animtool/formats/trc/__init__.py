"""TRC: marker trajectories as text, used by OpenSim and others."""
