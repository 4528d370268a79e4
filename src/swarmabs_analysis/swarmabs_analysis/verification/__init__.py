"""Whether a recorded run is what its scenario and its messages lead to: recomputed, compared bit for bit."""
