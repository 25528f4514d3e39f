"""What changes over time: `keys`, values at times that the scene or a file beside it has; and `forces`, which are
applied to vertices and come with a simulation.
"""
