"""Beam theory, measured mode shapes, the state-space wing and what its sensors see, named effects."""
