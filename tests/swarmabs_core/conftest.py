"""Property tests draw the same examples every time, and take the time they need on a busy machine."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("swarmabs", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("swarmabs")
