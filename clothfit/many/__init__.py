"""Many fits: several scenes, or several starts of one, on processes or a cluster.

job is one fit as data, from a start that may be drawn; batch runs many jobs on a pool; processes and cluster are the
pools; estimate_many is the public function. warmup compiles ahead of time.
To add a pool: a module like processes, and a line in `estimate_many.chosen_pool`.
"""
