"""The defects of the report's noise, and which of them make its figure 1b."""
