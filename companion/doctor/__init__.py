"""What ``spanwise doctor`` looks at: one file per subject, pure functions from evidence to findings."""
