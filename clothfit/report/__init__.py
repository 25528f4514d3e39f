"""A page that shows a fitted scene: the motion beside its target in 3-D, charts, parameters.

showing (what is compared, frame by frame) → contents (all that the page tells, arrays packed by packing, the fit's way
from log) → assembly (the HTML file, from the parts in `web/`) → page (the function that users call).
To add a chart: its numbers in contents, and a module in `web/`.
"""
