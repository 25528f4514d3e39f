"""Models of cloth in other tools: how they move a scene, and the derivatives of that.

`constraint` has what a constraint of XPBD measures, `projection` one correction by it, `substep` and `sweeps` the steps
of a motion, `xpbd` the model of a scene. To add a tool, write a module like `xpbd`. All of it is loaded, and its
kernels are compiled, when it is asked for.
"""
