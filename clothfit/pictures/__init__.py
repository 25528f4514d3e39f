"""Pictures of motions and fits: numbers → polygons and curves → a file.

camera and polygons draw a cloth; filmstrip, gif and overlay show motions, maps what is fitted, charts curves, diagram
speed against error; plots puts them on a page; picture_file says which kinds of file there are and writes them.
To add a picture: a module here, and a line in plots.
"""
