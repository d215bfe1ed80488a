"""A second truth for blind trials, by another hand: finite elements of a wing that is free at its fuselage.

Imports nothing of Spanwise. What differs from ``tools.trial_truths.wing``: the wing (tapered beam, tip pods, four
elastic modes a family, a fuselage that recoils), the integrator (matrix exponential of the linear part, forces by
Heun's rule), the gust (white through the band or with a corner, left and right by themselves), the sensors' own
filters, a root sensor, manoeuvres in half of the flights, and the forms in which effects come.
"""
