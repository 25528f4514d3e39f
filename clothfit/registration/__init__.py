"""Targets with another clock or another place than the scene, and with mislabelled markers.

record is a registration: rate, offset, rotation, translation, scale; and the markers that are swapped or false, which
mislabelled finds in a target without any simulation. residuals has the values of a scene and the registrations of its
targets as one vector of unknowns, with what is left and its derivative, and brings them down together, from what the
targets show by themselves (free_fall). tracking draws a simulated cloth to the points of a scan
(`fit.tracked_fit`). `fit.registered_fit` begins with few values, and looks again after a fit.
To add a coordinate of registrations: its derivative in residuals, its field in record.
"""
