"""What all else builds on: angles, poses, trajectories, cameras, files; no ROS, no simulation."""
