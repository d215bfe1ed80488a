"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# the first call may have to compile, and a shared machine may stop for seconds: time is no verdict
settings.register_profile("spanwise", deadline=None)
settings.load_profile("spanwise")
