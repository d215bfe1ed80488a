"""Hostile inputs, made at random from valid ones: every case ends in data or in one of our refusals.

``python -m sitl_tests.fuzz --seconds 3600`` runs all targets; ``test_fuzz.py`` a fixed number of cases of each.
"""
