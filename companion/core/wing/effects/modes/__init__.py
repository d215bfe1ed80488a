"""Effects that add or couple modes."""
