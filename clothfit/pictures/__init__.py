"""Pictures of motions and fits: numbers → pixels and curves → a file.

camera, solids and stage draw a scene, with the keys and forces of a controlled motion; gif shows motions, maps fitted
parameters, charts curves, diagram speed against error; plots lays out a page with a filmstrip; picture_file has the
colours, knows the kinds of file and writes them.
To add a picture: a module here, and a line in plots.
"""
