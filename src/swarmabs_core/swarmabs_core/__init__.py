"""Mathematics and node behaviour of swarmabs, without ROS."""

from swarmabs_core.simulation import simulate

__all__ = ["simulate"]
