"""One file for each node."""
