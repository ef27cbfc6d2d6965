"""The robot on the map, by the truth of the simulation."""
