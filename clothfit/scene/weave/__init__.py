"""How the cloth of an object is woven and divided: what the file says of it, and what its mesh shows.

layout (the fields `families`, `regions` and `warp`) and directions (which edges run along, across, diagonally), which
`scene/families` puts together. To add a field: its rule in the schema, its check and its attribute in layout.
"""
