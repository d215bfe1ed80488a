"""The audit of the seed paper: every table, figure, equation and experiment, from the code that flies."""
