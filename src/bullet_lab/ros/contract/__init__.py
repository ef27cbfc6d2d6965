"""The contract: does a simulator keep the promises of Gazebo's ROS interface?"""
