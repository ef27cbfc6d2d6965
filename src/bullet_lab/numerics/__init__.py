"""Numbers only: angles, SE(2), trajectories, odometry noise and metrics; needs just numpy."""
