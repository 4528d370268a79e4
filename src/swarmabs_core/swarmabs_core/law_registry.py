"""Where packages that bring a swarm law have imported it from; new ones import from `swarmabs_core.swarm_law`."""

from swarmabs_core.swarm_law import LAWS, PAPER, Command, Robot, SwarmLaw

__all__ = ["LAWS", "PAPER", "Command", "Robot", "SwarmLaw"]
