"""Mathematics and node behaviours of swarmabs, without ROS."""
