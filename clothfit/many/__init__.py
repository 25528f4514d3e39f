"""Many fits: several scenes, or several starts of one, on processes or a cluster.

starts draws starting values; job is one fit as data; batch runs many jobs on a pool; processes and cluster are the
pools; estimate_many is the public function. warmup compiles ahead of time.
To add a pool: a module like processes, and a line in `estimate_many.chosen_pool`.
"""
