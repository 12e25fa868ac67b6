"""Rules on rigs, clips, scenes and captures, and what they find."""
