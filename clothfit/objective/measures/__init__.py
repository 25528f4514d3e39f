"""What of a motion is compared: one file each.

measure says what they have in common and how to add one; position, velocity, edge_length and spectrum are those there
are.
"""
