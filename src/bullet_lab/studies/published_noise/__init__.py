"""Which of the report's defects make its figure 1b?"""
