"""The engine: a System of arrays, its forces, one step, and step after step.

solve/ (linear systems) → forces/ → inputs/ (what changes over time) → system → step/ → march (steps in one compiled
loop) → equilibrium (a cloth at rest) → rollout (what is kept of them) → tape (a motion in parts).
Each imports only what stands before it. snapshots plans which states a tape keeps, fallbacks counts where ordinary
steps were not enough, stability says how long explicit and symplectic steps may be.
To add a force: see the page of `forces`; an integrator: see the page of `step`.
"""
