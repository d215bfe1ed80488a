"""A structure driven by a force that was measured: the law of its spring and damper."""
