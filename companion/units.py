"""Physical constants that every room shares; imports nothing."""

GRAVITY_MPS2 = 9.80665
"""Standard acceleration of gravity, a convention (3rd CGPM, 1901): what ``g`` means in every unit and log."""
