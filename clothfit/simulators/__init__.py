"""Models of cloth in other tools: how they move a scene, and the derivatives of that.

`projection` has what a constraint of XPBD measures and one correction by it, `substep` the steps of a motion,
`directions` their derivatives, `xpbd` the model of a scene; `values` and `many_values` are the fits. To add a tool,
write a module like `xpbd`. All of it is loaded, and its kernels are compiled, when it is asked for.
"""
