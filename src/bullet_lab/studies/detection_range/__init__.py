"""From where the marker is found, and how well."""
