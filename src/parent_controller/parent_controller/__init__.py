"""Node that turns the plane's state into the desired abstract state."""
