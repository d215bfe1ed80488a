"""Self-excited vibration: limit cycles and what grows into them or decays from them, against airspeed and amplitude."""
