"""Every conversion between messages and the library's own data."""
