"""The recorder: a node that writes a run to a bag and reports its figures to the orchestrator."""
