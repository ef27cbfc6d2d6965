"""The web page of the view, without ROS: its scene, its server and its drive pad."""
