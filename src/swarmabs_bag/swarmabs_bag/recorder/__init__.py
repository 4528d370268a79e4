"""The recorder: a node that writes a run to a bag, and its figures to the orchestrator."""
