"""Every tunable and the airframe schema, declared once."""
