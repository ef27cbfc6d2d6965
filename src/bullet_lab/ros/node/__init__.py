"""Start, parameters, publishers, lock step and transforms of all nodes."""
