"""Effects on the stiffness: frequencies, and the bend under load."""
