"""What the ROS nodes of swarmabs share."""
