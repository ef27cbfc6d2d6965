"""A module that other packages import."""


def doubled(number):
    """Return twice a number."""
    return 2 * number
