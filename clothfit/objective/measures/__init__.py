"""What of a motion is compared: one file each.

measure has what they share and how to add one; position, velocity, edge_length and spectrum are the four that exist.
Each is a class with residuals, their derivative and its transpose.
"""
