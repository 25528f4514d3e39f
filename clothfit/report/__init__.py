"""A page that shows a fitted scene: the motion beside its target in 3-D, charts, parameters.

showing (the compared motions) → contents (everything on the page; packing packs its arrays, log reads the course of the
fit) → page (the HTML file, from the parts in `web/`). control_contents has that of a motion that is led through
keys, subspace_contents that of a cloth on a subspace beside its full simulation.
To add a chart: its numbers in contents, and a module in `web/`.
"""
