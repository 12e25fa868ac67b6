"""OpenSim motion (MOT, STO): joint coordinates over time."""
