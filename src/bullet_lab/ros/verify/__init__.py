"""Whether jobs repeat: on this machine to the byte, elsewhere as a page says."""
