"""MCAP files: their records, chunks and index, written and read; nothing about a swarm or its messages."""
