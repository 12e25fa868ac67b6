"""Rule checks: functions from a subject to its faults, one concept per module."""
