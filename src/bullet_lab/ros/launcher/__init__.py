"""The launcher behind scripts/run.sh: lists jobs, checks their arguments, runs and stops them."""
