"""Replays: a bag's messages again, for nodes under test in lockstep, or at the pace at which they were recorded."""
