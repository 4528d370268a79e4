"""Node of one robot: computes its command from the broadcasts and its own state."""
