"""Recordings as uniform tables: accelerations, toe, load factor, covariates; defects of the samples themselves."""
