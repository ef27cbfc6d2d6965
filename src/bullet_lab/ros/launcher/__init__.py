"""The launcher behind scripts/run.sh: it lists jobs, checks arguments, runs and stops jobs."""
