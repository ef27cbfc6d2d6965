"""What every node is made of: start, parameters, publishers, lock step, transforms."""
