"""Parts of `clothfit subspace`: lengths (a length from a text), inputs (those of a file), playing (one motion, or many
instances at once).
"""
