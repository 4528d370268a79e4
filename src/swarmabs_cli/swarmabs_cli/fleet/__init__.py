"""Commands that operate swarms in real time."""
