"""Output of commands in a terminal: the live view, plain lines, progress, the demo's tables."""
