"""Describe worlds and models, and read them from SDF, URDF, xacro and mesh files."""
