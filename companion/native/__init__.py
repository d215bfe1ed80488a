"""The inner loops in C, compiled when the package is built, and their loader."""
