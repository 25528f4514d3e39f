"""Targets with another clock or another place than the scene: which, found with few values of the scene beside it.

record is a registration: rate, offset, rotation, translation, scale. residuals has what is left with one, and the
derivative by it; search joins it with the scene's values for Gauss–Newton and looks for the best one, from what the
target shows by itself (free_fall). record has the markers that are swapped or false as well, which mistaken finds in a
target without any simulation. `fit.registered_fit` has their intervals beside the values of a fit.
To add a coordinate of registrations: its derivative in residuals, its field in record.
"""
