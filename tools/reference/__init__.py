"""An oracle that shares no code with the estimator: its own wing truth, its own sensors, its own optimal filter."""
