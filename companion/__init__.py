"""Spanwise: stereo ranges that stay true while the wing bends. The rooms are drawn in companion/README.md."""
