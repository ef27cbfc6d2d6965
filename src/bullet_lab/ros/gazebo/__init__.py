"""Services and topics of Gazebo, and their clients."""
