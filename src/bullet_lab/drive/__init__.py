"""Controllers that drive robots in squares and to goals."""
