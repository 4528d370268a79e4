"""Commands that study scenarios."""
