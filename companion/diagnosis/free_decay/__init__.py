"""One structure that decays freely after impulses: its modes followed in time, however far their frequency goes."""
