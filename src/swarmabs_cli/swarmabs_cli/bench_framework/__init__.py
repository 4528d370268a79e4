"""Measuring speed, start, memory and recording, each beside a floor that was measured in the same minutes."""
