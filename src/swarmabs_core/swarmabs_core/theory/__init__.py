"""The paper's analysis, evaluated for a swarm before it moves (docs/explanation/equations.md, 7)."""
