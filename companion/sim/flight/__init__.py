"""The true flight: aircraft, gust, wing, inertial sensors."""
