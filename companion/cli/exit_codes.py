"""Exit codes of the commands beside 0 (done), 1 (bad input, dead device) and 2 (wrong usage); the README lists them."""

NOTHING_TO_ESTIMATE = 3  # done, but no mode, no range, nothing identifiable
TO_FIX = 4  # the doctor has something to fix
