"""A flight judged by its truth: replay, geometry, metrics, plan outcomes, targets."""
