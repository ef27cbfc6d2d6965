"""What scripts import of Gazebo's gazebo_ros."""
