"""The view in a browser: the page, what it shows of topics and TF, what the user commands."""
