"""Former import path for packages that provide a swarm law; new packages import from `swarmabs_core.swarm_law`."""

from swarmabs_core.swarm_law import LAWS, PAPER, Command, Robot, SwarmLaw

__all__ = ["LAWS", "PAPER", "Command", "Robot", "SwarmLaw"]
