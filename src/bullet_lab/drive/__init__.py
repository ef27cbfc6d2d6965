"""How a robot is driven: in squares, and to goals."""
