"""Long runs of random scenarios with random faults, watched step by step."""
