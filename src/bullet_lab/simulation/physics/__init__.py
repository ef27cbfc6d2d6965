"""Bodies in PyBullet: how they are made, how they move, and what they touch."""
