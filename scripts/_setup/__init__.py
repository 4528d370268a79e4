"""How scripts/swarm prepares .venv and install/; standard library only, Python 3.8 and later."""
