"""A mobile-robotics lab that runs without Gazebo: numerics, simulation and ROS nodes."""
