"""The swarm as messages for RViz and Foxglove: joint state, transforms, markers, URDF of the plane."""
