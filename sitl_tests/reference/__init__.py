"""Readable versions of the compiled inner loops, to which tests hold the C; they share no code with it."""
