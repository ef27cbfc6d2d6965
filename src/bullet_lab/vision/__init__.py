"""What images show: markers, edges, corners. OpenCV and numpy, no ROS."""
