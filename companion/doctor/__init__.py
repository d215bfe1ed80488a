"""Checks of ``spanwise doctor``: one file per subject, pure functions from evidence to findings."""
