"""What a world and its models are, and the formats that say it: SDF, URDF, xacro, meshes."""
