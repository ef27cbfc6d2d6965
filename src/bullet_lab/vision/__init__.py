"""Detectors of markers, edges and corners in images: OpenCV and numpy, no ROS."""
