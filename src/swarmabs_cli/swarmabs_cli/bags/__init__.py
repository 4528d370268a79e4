"""Commands that use recordings."""
