"""The contacts of a model with others, with their forces and places."""

from collections import Counter


def contact_points(simulation, name):
    """Yield the contact points of a model: the other model, the place (m), the force (N)."""
    models = simulation.models
    owners = {b.unique_id: one for one in models for b in models[one].bodies.values()}
    for body in models[name].bodies.values():
        for point in body.touching_points():
            yield owners[point[2]], point[5], point[9]


def pressures(simulation, name):
    """Return the sum of the normal forces (N) of a model on each other model."""
    sums = Counter()
    for other, _, force in contact_points(simulation, name):
        sums[other] += force
    return sums


def strongest_place(simulation, name, other):
    """Return the place (m) of the contact point with another model that has the most force."""
    points = [point for point in contact_points(simulation, name) if point[0] == other]
    return max(points, key=lambda point: point[2])[1]
