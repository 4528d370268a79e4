"""Common parts of the ROS nodes of swarmabs."""
