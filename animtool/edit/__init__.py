"""Changes to a whole take: passes over its time, its joints and its layers."""
