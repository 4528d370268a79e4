"""Sweeps: grid and Monte-Carlo studies over scenarios, here on all cores or on a Dask scheduler."""
