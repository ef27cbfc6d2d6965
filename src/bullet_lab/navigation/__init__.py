"""Navigation on a map: occupancy grids, planning, and driving along a plan."""
