"""The inner loops as plain Python and numpy: what ``companion/native`` says in C."""
