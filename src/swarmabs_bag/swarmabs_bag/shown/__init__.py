"""What people see of a swarm, in every view and report: its state at each step, colours, percentile bands."""
