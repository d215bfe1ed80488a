"""Time of one clock from another: offset, skew, error bound, or an explicit "not synced"."""
