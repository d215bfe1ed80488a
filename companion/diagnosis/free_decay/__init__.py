"""One structure that knocks make ring: its modes followed in time, however far their frequency goes."""
