"""Targets with another clock or another place than the scene, and with mislabelled markers.

record is a registration: rate, offset, rotation, translation, scale; and the markers that are swapped or false, which
mislabelled finds in a target without any simulation; free_fall is what targets show by themselves. tracking draws a
simulated cloth to the points of a scan (`fit.tracked_fit`). `fit.registration` brings the values of a scene and the
registrations of its targets down together; `fit.registered_fit` begins with few values, and looks again after a fit.
To add a coordinate of registrations: its field in record, its derivative in `fit.registration`.
"""
