"""What each job leaves behind: columns, summary and figure, without ROS."""
