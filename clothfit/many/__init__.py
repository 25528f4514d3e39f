"""Many fits: several scenes, or several starts of one, on processes or a cluster.

starts → job (one fit, as data) → worker (where it runs) → processes, cluster (how they are sent there) → batch (what
is done when one ends) → estimate_many. warmup compiles beforehand.
To add a way to run jobs: a module like processes, and a line in estimate_many.
"""
