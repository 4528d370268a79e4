"""Commands that run swarms."""
