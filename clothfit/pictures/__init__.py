"""Pictures of motions and fits: numbers → pixels and curves → a file.

palette has the colours; camera, solids and stage draw a scene; gif shows motions, marks has the keys and forces of a
controlled one, maps shows fitted parameters, charts curves, diagram speed against error; plots lays out a page with a
filmstrip; picture_file knows the kinds of file and writes them.
To add a picture: a module here, and a line in plots.
"""
