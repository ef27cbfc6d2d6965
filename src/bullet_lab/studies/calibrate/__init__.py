"""The parameters of noise models and of systematic errors, from paths with truth."""
