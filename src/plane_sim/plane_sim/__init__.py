"""Node that simulates the tilting plane."""
