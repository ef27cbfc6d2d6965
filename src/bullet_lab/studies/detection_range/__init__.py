"""The range of the marker's detection: from where it is found, and how well."""
