"""The stepping loop of the bridge, its speed, lock step, and the topics of the world."""
