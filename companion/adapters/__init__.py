"""The only code that knows a device or a format."""
