"""Common to the missions: the link, the traffic on it, the guard of the flight, the recording, and the exit codes."""
