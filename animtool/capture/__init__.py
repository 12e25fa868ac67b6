"""Motion capture: takes from anywhere onto the rig of a production."""
