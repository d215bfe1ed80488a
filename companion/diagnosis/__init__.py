"""Errors of the simulation on measured data: likelihood, score tests, selection, cross-validation, report."""
