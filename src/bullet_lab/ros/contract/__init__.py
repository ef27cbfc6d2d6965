"""The contract that Gazebo's ROS interface is: rows in config/contract, checked on a master."""
