"""Packages that bring drives are installed here as in the tests of the core."""

from tests.swarmabs_core.conftest import packages

__all__ = ["packages"]
