"""Adaptation in flight: modal and gust parameters from the spectra of the last seconds."""
