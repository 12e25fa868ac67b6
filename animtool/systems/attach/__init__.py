"""Secondary motion: what a rig's ``attach`` lists, moved by its joints."""
