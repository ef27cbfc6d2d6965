"""What scripts import of ros_control's controller_manager."""
