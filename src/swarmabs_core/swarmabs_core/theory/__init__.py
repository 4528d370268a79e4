"""What the paper's analysis says about a swarm before it moves (docs/explanation/equations.md, 7)."""
