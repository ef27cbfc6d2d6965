"""Printed markers as images and as things to put into a world."""
