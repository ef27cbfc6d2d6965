"""A world in a browser: the page, who may see it, and what the scene is made of; without ROS."""
