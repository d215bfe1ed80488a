"""Likelihood of a flight: spectra of the accelerations (Whittle), and the toe given them."""
