"""Node that computes the desired abstract state from the plane's state."""
