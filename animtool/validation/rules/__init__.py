"""The checks of rules: functions from a subject to its faults, a concept a module."""
