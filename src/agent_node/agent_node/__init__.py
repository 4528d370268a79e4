"""Node of one robot: from the broadcasts and its own state to its own command."""
