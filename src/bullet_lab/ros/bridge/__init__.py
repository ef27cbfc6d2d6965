"""The parts of the bridge: its loop, its pace, and what its devices say and take."""
