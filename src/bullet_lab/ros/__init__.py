"""ROS adapters: one module per node, parameters, conversions and the launcher of jobs."""
