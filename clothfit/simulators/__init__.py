"""Models of cloth in other tools: how they move a scene, and the derivatives of that.

`substep` has the parts of a step of XPBD and what its constraints measure, `directions` takes it, with derivatives or
without; `xpbd` has the model of a scene and its values; `values` has the fits. To add a tool, write a module like
`xpbd`. All of it is loaded, and its kernels are compiled, when it is asked for.
"""
