"""UMBmark: the wheels' diameters and their distance, from squares driven by odometry each way."""
