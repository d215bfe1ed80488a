"""Effects on the cameras and their mounts."""
