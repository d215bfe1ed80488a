"""Thin programs for people."""
