"""Models of cloth in other tools: how they move a scene, and the derivatives of that.

`substep` has the steps of XPBD and what its constraints measure, `directions` their derivatives, `xpbd` the model of a
scene; `values` has the fits. To add a tool, write a module like `xpbd`. All of it is loaded, and its kernels are
compiled, when it is asked for.
"""
