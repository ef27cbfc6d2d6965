"""Results as files that other tools read: TUM, CSV, JSON. No ROS, no plotting."""
