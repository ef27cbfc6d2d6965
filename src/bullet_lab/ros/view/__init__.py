"""The view: what topics and TF tell, in the page's scene, and what is asked for there, on ROS."""
