"""The compiled inner loops, their array types, and their readable twins."""
