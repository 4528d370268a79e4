"""The set-up of .venv and install/ by scripts/swarm; standard library only, Python 3.8 or later."""
