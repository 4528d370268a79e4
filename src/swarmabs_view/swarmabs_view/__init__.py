"""What people look at: a page in the browser, the terminal, RViz and Foxglove."""
