"""The simulated lab on PyBullet, without ROS: worlds, robots, what their plugins do, images.

The entry point is `bullet_lab.simulation.simulation.Simulation`.
"""
