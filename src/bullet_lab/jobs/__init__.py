"""The jobs: their declarations, their results, and the command that runs them without ROS."""
