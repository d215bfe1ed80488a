"""Our own MAVLink component: parameters, commands, files, texts, ranges."""
