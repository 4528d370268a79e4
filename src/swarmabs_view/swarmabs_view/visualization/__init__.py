"""The swarm in the messages that RViz and Foxglove draw: joint state, transforms, markers, URDF of the plane."""
