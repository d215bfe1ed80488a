"""The filter's inner loop and its array types."""
