"""Rules on rigs, clips, scenes and captures, and their findings."""
