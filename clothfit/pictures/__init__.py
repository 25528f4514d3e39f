"""Pictures of motions and fits: numbers → polygons and curves → a file.

palette has the colours; camera and polygons draw a cloth; filmstrip and gif show motions, overlay pairs a motion with
its target, marks has the keys and forces of a controlled one, maps shows fitted parameters,
charts curves, diagram speed against error; plots lays out a page;
picture_file knows the kinds of file and writes them.
To add a picture: a module here, and a line in plots.
"""
