"""Many flights at once: one task a file in plain processes, parts that outlive an interruption, a table and a page."""
