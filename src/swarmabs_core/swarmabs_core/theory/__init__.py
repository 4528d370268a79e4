"""What the paper's analysis says about a swarm before it moves (docs/equations.md, 7)."""
