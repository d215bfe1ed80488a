"""Effects on stamps and delays."""
