"""Setting up a companion's system: checks, the files that the service needs, and the way back."""
