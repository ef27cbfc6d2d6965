"""The view's node: it shows topics and TF on the web page and publishes what the user commands."""
