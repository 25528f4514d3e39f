"""Fits of many values by products with the derivative of their residuals, without any matrix.

products (J z and Jᵀ w, sweeps along the motion) → block_gradients (equations for several right sides at once) →
sampling (samples of the posterior, and the step to its mean).
"""
