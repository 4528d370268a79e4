"""Views of a swarm: a page in the browser, the terminal, RViz and Foxglove."""
