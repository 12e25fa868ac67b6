"""Secondary motion of a rig's attachments: chains, strands and cloth."""
