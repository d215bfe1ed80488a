"""Truths of the blind trials of the diagnosis, and what can be hidden in them; they import nothing of Spanwise."""
